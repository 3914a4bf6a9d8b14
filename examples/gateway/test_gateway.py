"""Does the gateway hand on what the transmission sends, so that its clutches can still be diagnosed behind it?"""

import can

from diag_service import expect_frames, expect_same_frames, expect_shifts, expect_verdict

PATIENCE_S = 300  # a hang; the first gear change comes after three seconds
FRAMES = 50  # of each of two identifiers


def test_every_frame_comes_out_as_it_went_in(gateway, recorded_frames):
    received = recorded_frames(gateway.far)
    sent = [can.Message(arbitration_id=0xA0 + number % 2, data=[number % 256] * 8, is_extended_id=False)
            for number in range(2 * FRAMES)]  # fmt: skip
    with gateway.near.open() as bus:
        for message in sent:
            bus.send(message)
        received.wait_until_quiet(0.5, timeout_s=PATIENCE_S)
    expect_same_frames(sent, received.messages)


def test_a_gear_change_can_be_diagnosed_behind_the_gateway(gateway, emulated_vehicle, diagnosis, recorded_frames):
    sent, received = recorded_frames(gateway.near), recorded_frames(gateway.far)
    behind = diagnosis(gateway.far)
    car = emulated_vehicle("ideal", bus=gateway.near)
    behind.wait_for(shift_count=1, timeout_s=PATIENCE_S)
    car.stop()
    received.wait_until_quiet(0.5, timeout_s=PATIENCE_S)
    analysis = behind.stop()

    expect_same_frames(sent.messages, received.messages)
    expect_frames(analysis, least=1000)
    expect_shifts(analysis, least=1)
    expect_verdict(analysis, 2, "no verdict", "good")  # one shift is not much
