"""Frames of the wire contract for tests: a short drive with every message, as the emulator encodes it."""

import numpy as np

from canlog.arrays import FloatArray
from canlog.e2e.message_contract import message_contracts
from canlog.frames import FrameBatch
from dbc.contract import load_contract
from ecu_emulator.bus.frames import EncodedFrames, FrameEncoder
from ecu_emulator.drive.build import ROAD_MESSAGES
from ecu_emulator.sensing import Readings

START_NS = 1_767_225_600_000_000_000  # 2026-01-01T00:00:00Z
DATABASE = load_contract()
CONTRACTS = message_contracts(DATABASE)
CYCLE_CONTRACTS = {name: contract for name, contract in CONTRACTS.items() if name not in ROAD_MESSAGES}


def readings(message: str, t_s: FloatArray, rng: np.random.Generator) -> Readings:
    """Return readings of one message at given times, in a range that every signal can carry."""
    spans = {"k": (250.0, 350.0), "pa": (1e4, 1e5), "m_s": (0.0, 60.0), "ratio": (0.0, 1.0), "rad_s": (0.0, 700.0)}
    spans |= {"nm": (-400.0, 900.0), "odometer_m": (0.0, 4e9), "light": (0.0, 1.0), "state": (0.0, 3.0)}
    values = {}
    for quantity in FrameEncoder(DATABASE).quantities(message):
        low, high = next((span for kind, span in spans.items() if quantity.endswith(f"_{kind}")), (0.0, 4.0))
        low, high = spans.get(quantity, (low, high))
        values[quantity] = rng.uniform(low, high, len(t_s))
    return Readings(message=message, t_s=t_s, values=values)


def drive(duration_s: float, seed: int = 0) -> EncodedFrames:
    """Return all frames of a shift cycle, on schedule."""
    rng = np.random.default_rng(seed)
    encoder = FrameEncoder(DATABASE)
    times_s = {
        name: np.arange(contract.phase_ms, round(duration_s * 1000.0), contract.cycle_ms) / 1000.0
        for name, contract in CYCLE_CONTRACTS.items()
    }
    return encoder.encode_all([readings(name, t_s, rng) for name, t_s in times_s.items()])


def received(frames: EncodedFrames) -> FrameBatch:
    """Return frames as a source hands them over: bus time in whole microseconds."""
    t_ns = START_NS + np.round(frames.t_s * 1e6).astype(np.int64) * 1000
    return FrameBatch(t_ns=t_ns, can_id=frames.can_id, length=frames.length, data=frames.data)


def of_message(batch: FrameBatch, name: str) -> FrameBatch:
    """Return the frames of one message."""
    rows = np.flatnonzero(batch.can_id == CONTRACTS[name].can_id)
    return batch[rows]
