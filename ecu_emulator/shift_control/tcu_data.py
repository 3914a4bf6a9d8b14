"""What the shift control senses, commands, remembers and is tuned with: places in its arrays, and its parameters.

Pairs hold clutch 1 (odd gears) first; clutch 2 follows.
"""

from typing import NamedTuple, Protocol

MOST_GEARS = 9  # of any gearbox; arrays by gear have room for as many, so that all are of one type
PERIOD_S = 1.0e-3

# Shift phases, as on the bus.
HOLD = 0
PREFILL = 1
TORQUE = 2
INERTIA = 3
LOCK_UP = 4

# Stages of the workshop routine; with NO_ROUTINE the shift control drives.
NO_ROUTINE = 0
OPEN_REVS = 1
CLOSED_REVS = 2
ENGAGING = 3
FILLING = 4
LAUNCHING = 5
LOCKING = 6
WAITING = 7  # idling with the brake held until somebody asks for the routine

# Stages of the pressure steps that a touch point is looked for with; they too begin and end with WAITING.
STEPS_ENGAGING = 8  # a gear against the brake
STEPS_OPEN = 9  # clutch empty
STEPS_FILLING = 10
STEPPING = 11
STEPS_RELEASING = 12

# Places in the array of what the control senses: SLIP, FILL, GEAR and IS_ENGAGED hold a pair, clutch 1 first.
ENGINE_SPEED = 0
ENGINE_TORQUE = 1
SLIP = 2
FILL = 4
IS_LOCKED = 6
SHAFT_GEAR = 8  # gear on, or being synchronised to, the shaft; 0 none
IS_ENGAGED = 10
SENSE_COUNT = 12

# Places in the array of what the control commands.
PRESSURE = 0
TORQUE_COMMAND = 2
WANTED_GEAR = 4  # gear each shaft shall have, 0 neutral
THROTTLE = 6
SPARK = 7
BRAKE = 8
COMMAND_COUNT = 9

# Places in the memory of the control.
CURRENT_GEAR = 0
TARGET_GEAR = 1
PHASE = 2
PHASE_TIME = 3
DWELL = 4  # time since the current gear was reached
INPUT_TORQUE = 5  # filtered engine torque
START_SLIP = 6
INTEGRAL = 7
LOCKED_TIME = 8
NEUTRAL_TIME = 9
IS_DRIVING = 10
COAST_TIME = 11
CYCLE = 12
IS_FILLED = 13
RAMP_START = 14
IS_FINISHED = 15  # 1: driven to the end; `IS_STUCK`: a shift does not end, or never begins
ROUTINE = 16  # stage of the workshop routine
REV = 17  # number of the rev within its stage, 0 between revs
REV_TIME = 18  # since the rev or the wait before it began
IS_REVVING = 19  # the pedal is down
OPEN_REV_COUNT = 20  # revs asked for
CLOSED_REV_COUNT = 21
STEP_CLUTCH = 22  # whose pressure is stepped
STEP_TOP = 23  # pressure of the first step [Pa]
STEP_DOWN = 24  # by which each step is lower than the one before [Pa]
STEP_COUNT = 25
STEP = 26  # steps that are over
MEMORY_COUNT = 27
IS_STUCK, LONGEST_SHIFT_S = 2.0, 20.0  # of one phase: its clutch cannot carry what the engine gives
LONGEST_GEAR_S = 300.0  # in one gear: by then the car is as fast, and the oil as warm, as they get

# Columns of the table of cycles.
CYCLE_PEDAL = 0
CYCLE_BRAKE = 1
CYCLE_MU = 2  # factors on mu_c1, mu_s1, mu_c2, mu_s2
CYCLE_UP = 6  # speeds, leaving gears 1, 2, ...; 0 for the highest one and beyond
CYCLE_DOWN = CYCLE_UP + MOST_GEARS  # speeds, leaving gears 2, 3, ...
CYCLE_COLUMN_COUNT = CYCLE_DOWN + MOST_GEARS


class ControlParameters(NamedTuple):
    """Numbers of the shift control and the driver."""

    friction_coefficient: float
    torque_filter_s: float
    upshift_speeds_rad_s: tuple[float, ...]  # w_up, leaving gears 1, 2, ...
    downshift_speeds_rad_s: tuple[float, ...]  # w_dn, leaving gears 2, 3, ...
    dwell_s: float
    hold_gain_ratio: float
    hold_margin_nm: float
    preselect_delay_s: float
    preselect_fill_ratio: float
    neutral_time_s: float
    prefill_time_s: float
    prefill_pressure_pa: float
    prefill_ratio: float
    touch_margin_pa: float
    release_gain_ratio: float
    release_margin_nm: float
    torque_phase_s: float
    overlap_margin_nm: float
    overlap_gain_ratio: float
    dump_ratio: float
    flare_gain_nms_rad: float
    flare_free_rad_s: float
    flare_limit_rad_s: float
    upshift_inertia_phase_s: float
    downshift_inertia_phase_s: float
    overshoot_rate_rad_s2: float
    overshoot_limit_rad_s: float
    slip_gain_nms_rad: float
    slip_integral_gain_nm_rad: float
    slip_integral_limit_rad: float
    min_torque_nm: float
    spark_reduction_ratio: float
    spark_stretch_ratio: float
    locked_slip_rad_s: float
    locked_time_s: float
    lockup_time_s: float
    top_gear_time_s: float
    brake_delay_s: float
    first_gear_time_s: float


class WorkshopParameters(NamedTuple):
    """Numbers of the workshop routine: revs in neutral, then a start from rest."""

    settle_time_s: float  # least wait before the first rev of a stage and before a gear is engaged
    rev_pedal_ratio: float
    rev_top_rad_s: float  # engine speed at which the pedal is released
    rev_bottom_rad_s: float  # engine speed at which a rev is over
    longest_rev_s: float  # the pedal is down for at most half of it
    launch_pedal_ratio: float
    launch_engine_rad_s: float  # speed at which the clutch holds the engine while the car gathers way
    launch_gain_nms_rad: float


class ClutchActuation(NamedTuple):
    """What the control believes about each clutch: pressure for no torque, pressure per torque.

    The touch points are those of the clutches if they are adapted, and change when they are adapted anew.
    """

    touch_pressure_pa: tuple[float, float]
    pressure_per_torque_pa_nm: tuple[float, float]
    inertia_kg_m2: float  # J_E + J_H


class ControlLaw(Protocol):
    """What the kernels of the control read of the law of a drive."""

    @property
    def actuation(self) -> ClutchActuation: ...
    @property
    def control(self) -> ControlParameters: ...
    @property
    def workshop(self) -> WorkshopParameters: ...
