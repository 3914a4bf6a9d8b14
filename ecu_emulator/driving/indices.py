"""Indices into the arrays that the kernels of a drive share; they follow those of the shift control in ``tcu_data``.

Pairs hold clutch 1 (odd gears) first; clutch 2 follows.
"""

from enum import IntEnum, unique

from ecu_emulator.shift_control import tcu_data

# What the controllers sense beyond `tcu_data`.
VEHICLE_SPEED = tcu_data.SENSE_COUNT
DIFF_SPEED = VEHICLE_SPEED + 1
SHAFT_SPEED = DIFF_SPEED + 1  # and the next, clutch side of each input shaft
HUB_SPEED = SHAFT_SPEED + 2
MANIFOLD = HUB_SPEED + 1  # [Pa]
GRADE = MANIFOLD + 1
OIL = GRADE + 1  # [K]
COOLANT = OIL + 1  # [K]
TURBINE_SPEED = COOLANT + 1  # behind a converter
TURBINE_TORQUE = TURBINE_SPEED + 1
IMPELLER_TORQUE = TURBINE_TORQUE + 1
GEAR_RATIO = IMPELLER_TORQUE + 1  # of an automatic gearbox, final drive included
SENSE_COUNT = GEAR_RATIO + 1

# What they command beyond `tcu_data`.
STARTER = tcu_data.COMMAND_COUNT  # torque of the starter [N m]
REQUEST = STARTER + 1  # how the transmission intervenes in the engine's torque
REQUESTED_TORQUE = REQUEST + 1  # [N m]
HILL_BRAKE = REQUESTED_TORQUE + 1  # least deceleration the brakes hold for the driver [m/s^2]
RATIO_RATE = HILL_BRAKE + 1  # at which an automatic gearbox changes its ratio [1/s]
COMMAND_COUNT = RATIO_RATE + 1

# How the transmission intervenes.
NO_REQUEST = 0
AT_LEAST = 1
EXACTLY = 2

# What they remember beyond `tcu_data`.
STATE = tcu_data.MEMORY_COUNT  # a DriveState
STATE_TIME = STATE + 1
EVENT_KIND = STATE_TIME + 1
EVENT_NUMBER = EVENT_KIND + 1  # 0 between events
EVENT_COUNT = EVENT_NUMBER + 1
IS_ABORTED = EVENT_COUNT + 1
ENGINE_STATE = IS_ABORTED + 1
ENGINE_TIME = ENGINE_STATE + 1  # in this state
IDLE_INTEGRAL = ENGINE_TIME + 1  # [N m]
OVERRUN_TIME = IDLE_INTEGRAL + 1  # since the driver's foot asked for nothing
DEMAND = OVERRUN_TIME + 1  # torque the driver asks of the crankshaft, filtered [N m]
PEDAL = DEMAND + 1
PEDAL_RATE = PEDAL + 1  # at which it goes down, smoothed [1/s]
BRAKE = PEDAL_RATE + 1  # [m/s^2]
SPEED_INTEGRAL = BRAKE + 1  # of the driver [m]
LOOKED_FOR_GEAR = SPEED_INTEGRAL + 1  # gear the idle shaft shall have
LOOKED_FOR_TIME = LOOKED_FOR_GEAR + 1  # since another one was better
NEUTRAL_SINCE = LOOKED_FOR_TIME + 1  # and the next: time each shaft has been without a gear
FROM_CLUTCH = NEUTRAL_SINCE + 2  # of the two between which torque is handed over
TO_GEAR = FROM_CLUTCH + 1  # gear of the leg: the bridge, then the target
SHARE = TO_GEAR + 1  # of the torque on the on-coming clutch
START_SPEED = SHARE + 1  # engine speed at the beginning of the leg [rad/s]
LAUNCH_SPEED = START_SPEED + 1  # engine speed the launch follows [rad/s]
LAUNCH_TORQUE = LAUNCH_SPEED + 1  # [N m]
LIFT_TIME = LAUNCH_TORQUE + 1  # since the pedal was released
WHIM_TIME = LIFT_TIME + 1  # left of a driver's whim
WHIM_PEDAL = WHIM_TIME + 1  # what it adds to the pedal
SHAFT_AHEAD = WHIM_PEDAL + 1  # what the launched shaft turns faster than the rolling car turns it, smoothed [rad/s]
LAUNCH_RATE = SHAFT_AHEAD + 1  # at which the engine is to become faster in a launch, smoothed [rad/s^2]
LOCKUP_STATE = LAUNCH_RATE + 1  # a LockUpState
LOCKUP_TIME = LOCKUP_STATE + 1  # in this state
LOCKUP_SLIP = LOCKUP_TIME + 1  # engine less turbine, smoothed [rad/s]
START_RATIO = LOCKUP_SLIP + 1  # of the gearbox, as a change of gear begins
REQUESTED_GEAR = START_RATIO + 1  # by somebody from outside, until it is engaged; 0: the map alone chooses
MEMORY_COUNT = REQUESTED_GEAR + 1

# Columns of the table of whims, one row per event.
WHIM_DELAY = 0  # after the begin of the event [s]; negative: none
WHIM_IN_GEAR_DELAY = 1  # after the event's end, if the gear is held so long [s]; negative: none
WHIM_LENGTH = 2  # [s]
WHIM_SIZE = 3  # on the pedal
WHIM_COLUMN_COUNT = 4


@unique
class DrivelineState(IntEnum):
    """What the transmission does with the engine's torque."""

    IN_GEAR = 0  # the clutch of the current gear holds
    CHANGING = 1  # a shift from clutch to clutch, or over the other shaft
    STANDSTILL = 2  # both clutches open, the car held
    CREEPING = 3  # clutch 1 carries little, the driver's feet rest
    LAUNCHING = 4  # a clutch slips until the car is as fast as the engine
    COASTING_OPEN = 5  # rolling with both clutches open


@unique
class LockUpState(IntEnum):
    """What the control does with the lock-up clutch of a converter, as on the bus."""

    OPEN = 0
    APPLYING = 1
    SLIPPING = 2  # under control
    LOCKED = 3
    RELEASING = 4


@unique
class EngineMode(IntEnum):
    FIRING = 0
    FUEL_CUT = 1  # turned by the car
    STOPPED = 2  # by the stop-start
    CRANKING = 3


@unique
class ManoeuvreKind(IntEnum):
    """Kinds of events; each has a start, an end, and one clutch whose friction it shows best."""

    NONE = 0
    CREEP = 1
    LAUNCH = 2
    POWER_ON_UPSHIFT = 3
    POWER_OFF_UPSHIFT = 4
    COAST_DOWNSHIFT = 5
    POWER_ON_DOWNSHIFT = 6
    KICKDOWN = 7  # a power-on downshift with the pedal far down
    POWER_ON_SKIP = 8  # 6-4, 5-3, 4-2 under power, over a gear of the other shaft
    COAST_SKIP = 9  # the same while coasting, with both clutches open meanwhile
    REGEAR = 10  # another gear while both clutches are open
    CLOSING = 11  # a clutch closes onto a car that rolls by itself
