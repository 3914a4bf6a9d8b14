"""A driving simulator moves the car, and gets the frames of its transmission, counters and checksums included.

The loop has the form that simulators such as CARLA have: each tick gives speed and pedal of the simulated car.

    python driving_simulator.py
"""

import can

from ecu_emulator import Emulator

TICK_S = 0.01


def simulated(step):
    """Return speed [m/s] and pedal of the simulated car, which speeds up for ten seconds, then rolls."""
    t_s = step * TICK_S
    return min(1.5 * t_s, 15.0), 0.3 if t_s < 10.0 else 0.08


def main():
    """Drive for twelve seconds with a worn clutch, and put its frames on a bus."""
    car = Emulator("ideal", cause="glazed-lining:1.5:1")
    with can.Bus("simulator", interface="virtual") as bus:
        count = 0
        for step in range(1200):
            for message in car.step(TICK_S, *simulated(step)):
                bus.send(message)
                count += 1
    gears = [shift.to_gear for shift in car.truth.shifts]
    print(f"{count} frames, changes to the gears {gears}")


if __name__ == "__main__":
    main()
