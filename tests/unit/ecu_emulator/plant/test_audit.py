from ecu_emulator.plant import Powertrain
from tests.support.cycles import FloatArray


def test_energy_is_conserved_over_a_cycle(driven_cycle: tuple[Powertrain, FloatArray]) -> None:
    train, _ = driven_cycle
    balance = train.power_balance
    assert abs(balance.residual_ratio) < 1e-3
    assert abs(balance.heat_residual_ratio) < 1e-3
    # The books hold something: the engine drove the car, brakes and road stopped it, the clutches slipped.
    assert balance.engine_j > 5.0e5
    assert balance.brake_j > 1.0e5
    assert balance.clutch_j > 1.0e4
    assert min(balance.bearing_j, balance.damper_j, balance.gear_j, balance.synchroniser_j, balance.tyre_j) > 0.0
