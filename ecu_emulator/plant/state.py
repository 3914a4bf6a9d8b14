"""Places in the arrays that the compiled kernels share; names as in docs/model.md. Clutch 2 follows clutch 1."""

from enum import IntEnum, unique

# Integrated together by the second-order method: bodies, springs, manifold, heat.
W_E = 0
W_H = 1
W_L = 2  # and 3
W_G = 4  # and 5
W_D = 6
W_W = 7
V = 8
PHI_FW = 9
PHI_SI = 10  # and 11
PHI_OS = 12
P_M = 13
T_C = 14  # and 15
T_OIL = 16
CRANK = 17
DISTANCE = 18
CONVERTER = 19  # torque of the impeller, which follows its map late
GEAR_RATIO = 20  # of an automatic gearbox, turbine over differential
RATE_COUNT = 21

# Integrated apart, because nothing mechanical acts back on them: lags, oil volume, film.
THROTTLE = 21
SPARK = 22
P_V = 23  # and 24
VOLUME = 25  # and 26
FILM = 27  # and 28

# Functions of the film, kept with it.
P_C = 29  # and 30, contact pressure
SHEAR = 31  # and 32, phi_f - phi_fs
OPENNESS = 33  # and 34, how far the pack drags like an open one: 0 film law, 1 open
STATE_COUNT = 35

# Torques behind the rates in the output of `rates.evaluate`.
T_FW = 21
T_F = 22  # and 23
T_V = 24  # and 25
T_SI = 26  # and 27
T_E = 28
T_OS = 29
T_SY = 30  # and 31
F_X = 32
T_IMPELLER = 33  # of the converter, on the hub
T_TURBINE = 34  # and 35, on the gearbox side of each shaft; the second has none
OUTPUT_COUNT = 36

# Inputs held over a millisecond (direction: until the slip reverses).
DIRECTION = 0  # and 1
RATIO = 2  # and 3, i(g) of the gear on each shaft
MU_C = 4  # and 5
MU_S = 6  # and 7
VISCOSITY = 8  # and 9
BRAKE = 10
THROTTLE_COMMAND = 11
SPARK_COMMAND = 12
P_COMMAND = 13  # and 14
T_COMMAND = 15  # and 16
PEDAL = 17
AIR_FLOW = 18
GRADE = 19
COOLANT = 20  # [K]
STARTER = 21  # torque of the starter on the crankshaft [N m]
OPEN_DRAG = 22  # and 23, greatest drag of the open pack [N m]; 0: the film law holds for open packs too
RATIO_RATE = 24  # at which an automatic gearbox changes its ratio [1/s]
INPUT_COUNT = 25

# Modes.
STICK = 0  # and 1
LINK = 2  # and 3
GEAR = 4  # and 5, gear on each shaft, 0 none
HELD = 6  # the brakes hold the car and its driven wheels at rest
MODE_COUNT = 7


@unique
class Col(IntEnum):
    """Column numbers of the array that `Powertrain.advance` returns."""

    T_S = 0  # scenario time [s]
    ENGINE_SPEED = 1  # w_E [rad/s]
    HUB_SPEED = 2  # w_H [rad/s]
    INPUT1_SPEED = 3  # w_L1 [rad/s]
    INPUT2_SPEED = 4  # w_L2 [rad/s]
    DIFF_SPEED = 5  # w_D [rad/s]
    WHEEL_SPEED = 6  # w_W [rad/s]
    VEHICLE_SPEED = 7  # v [m/s]
    CRANK_ANGLE = 8  # integral of w_E [rad]
    ENGINE_TORQUE = 9  # T_e [N m], friction and pumping deducted, without the pulses of the firings
    FLYWHEEL_TORQUE = 10  # T_FW [N m]
    CLUTCH1_TORQUE = 11  # T_F1 [N m], hub on gearbox side
    CLUTCH2_TORQUE = 12  # T_F2 [N m]
    VISCOUS1_TORQUE = 13  # T_V1 [N m]
    VISCOUS2_TORQUE = 14  # T_V2 [N m]
    SHAFT1_TORQUE = 15  # T_si1 [N m]
    SHAFT2_TORQUE = 16  # T_si2 [N m]
    PRESSURE1 = 17  # P_K1 [Pa]
    PRESSURE2 = 18  # P_K2 [Pa]
    PRESSURE1_COMMAND = 19  # [Pa]
    PRESSURE2_COMMAND = 20  # [Pa]
    TORQUE1_COMMAND = 21  # capacity the shift control asks of clutch 1 [N m]
    TORQUE2_COMMAND = 22  # capacity the shift control asks of clutch 2 [N m]
    FILM1 = 23  # h_1 [m]
    FILM2 = 24  # h_2 [m]
    CLUTCH1_TEMPERATURE = 25  # [K]
    CLUTCH2_TEMPERATURE = 26  # [K]
    SUMP_TEMPERATURE = 27  # [K]
    PEDAL = 28  # 0..1
    THROTTLE = 29  # 0..1
    BRAKE = 30  # deceleration demand [m/s^2]
    CURRENT_GEAR = 31  # 1..6, the old gear until the lock-up ramp ends; 0 neutral
    TARGET_GEAR = 32  # 1..6, the new gear from the prefill on; 0 neutral
    PRESELECTED_GEAR = 33  # gear engaged on the idle shaft, 0 while none is
    SHIFT_PHASE = 34  # 0 hold, 1 prefill, 2 torque, 3 inertia, 4 lock-up
    STICK1 = 35  # 1 while clutch 1 is locked
    STICK2 = 36  # 1 while clutch 2 is locked
    DISTANCE = 37  # [m]
    MANIFOLD_PRESSURE = 38  # p_m [Pa]
    MU_C1 = 39  # true friction now
    MU_S1 = 40
    MU_C2 = 41
    MU_S2 = 42
    ROUTINE = 43  # stage of the workshop routine, 0 without
    REV = 44  # number of the rev in neutral within its stage, 0 outside
    SHAFT1_GEAR = 45  # gear engaged on the input shaft, 0 while none is
    SHAFT2_GEAR = 46
    DRIVE_STATE = 47  # `ecu_emulator.driving.indices.DriveState`; 0 on the shift cycles
    EVENT_KIND = 48  # `ecu_emulator.driving.indices.EventKind`; 0 on the shift cycles and between events
    EVENT_NUMBER = 49  # number of the event within the drive, counted from 1, 0 between events
    IS_ABORTED = 50  # 1 once the event goes back to where it began
    ENGINE_STATE = 51  # `ecu_emulator.driving.indices.EngineState`; 0 on the shift cycles
    COOLANT_TEMPERATURE = 52  # [K]
    GRADE = 53  # rise over way, positive uphill
    WANTED_SPEED = 54  # what the trace asks for now [m/s]; 0 on the shift cycles
    TURBINE_SPEED = 55  # w_G of shaft 1 [rad/s]: behind a converter the turbine
    IMPELLER_TORQUE = 56  # of the converter [N m]
    TURBINE_TORQUE = 57
    LOCKUP_STATE = 58  # `ecu_emulator.driving.indices.LockUpState`; 0 without a converter
