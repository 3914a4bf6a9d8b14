"""Places in the arrays that the compiled kernels share; names as in docs/model.md. Clutch 2 follows clutch 1."""

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
RATE_COUNT = 19

# Integrated apart, because nothing mechanical acts back on them: lags, oil volume, film.
THROTTLE = 19
SPARK = 20
P_V = 21  # and 22
VOLUME = 23  # and 24
FILM = 25  # and 26

# Functions of the film, kept with it.
P_C = 27  # and 28, contact pressure
SHEAR = 29  # and 30, phi_f - phi_fs
OPENNESS = 31  # and 32, how far the pack drags like an open one: 0 film law, 1 open
STATE_COUNT = 33

# Torques behind the rates in the output of `rates.evaluate`.
T_FW = 19
T_F = 20  # and 21
T_V = 22  # and 23
T_SI = 24  # and 25
T_E = 26
T_OS = 27
T_SY = 28  # and 29
F_X = 30
OUTPUT_COUNT = 31

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
INPUT_COUNT = 24

# Modes.
STICK = 0  # and 1
LINK = 2  # and 3
GEAR = 4  # and 5, gear on each shaft, 0 none
HELD = 6  # the brakes hold the car and its driven wheels at rest
MODE_COUNT = 7
