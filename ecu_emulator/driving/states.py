"""What drive and engine are doing, and the kinds of events that a drive is made of; numbers as in the plant's rows."""

from enum import IntEnum, unique


@unique
class DriveState(IntEnum):
    """What the transmission does with the engine's torque."""

    IN_GEAR = 0  # the clutch of the current gear holds
    CHANGING = 1  # a shift from clutch to clutch, or over the other shaft
    STANDSTILL = 2  # both clutches open, the car held
    CREEPING = 3  # clutch 1 carries little, the driver's feet rest
    LAUNCHING = 4  # a clutch slips until the car is as fast as the engine
    COASTING_OPEN = 5  # rolling with both clutches open


@unique
class EngineState(IntEnum):
    """What the engine does."""

    FIRING = 0
    FUEL_CUT = 1  # turned by the car
    STOPPED = 2  # by the stop-start
    CRANKING = 3


@unique
class EventKind(IntEnum):
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
