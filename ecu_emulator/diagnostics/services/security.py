"""Service 27: a seed, a key, and a delay for those who guess; after ISO 14229-1 annex I."""

from dataclasses import replace

from ecu_emulator.diagnostics.codes import Nrc
from ecu_emulator.diagnostics.descriptions import SecurityLevel
from ecu_emulator.diagnostics.services.call import Call, Result
from ecu_emulator.diagnostics.state import ServerState


def security_access(call: Call) -> Result:
    """Give a seed (odd sub-function) or take a key (the even one after it)."""
    is_seed_wanted = call.sub_function % 2 == 1
    level = call.table.levels[call.sub_function if is_seed_wanted else call.sub_function - 1]
    return _give_seed(call, level) if is_seed_wanted else _take_key(call, level)


def key_of(level: SecurityLevel, seed: bytes) -> bytes:
    return (int.from_bytes(seed, "big") ^ level.key_mask).to_bytes(level.seed_bytes, "big")


def delay_over(state: ServerState, level: SecurityLevel, t_s: float) -> ServerState:
    """Return the state after a delay has run out: one more key may be tried."""
    until_s = state.locked_until_s.get(level.number)
    if until_s is None or t_s < until_s:
        return state
    return replace(
        state,
        locked_until_s={number: time for number, time in state.locked_until_s.items() if number != level.number},
        wrong_keys={**state.wrong_keys, level.number: level.most_attempts - 1},
    )


def _give_seed(call: Call, level: SecurityLevel) -> Result:
    if len(call.payload) != 2:
        return Nrc.INCORRECT_LENGTH
    if call.state.unlocked == level.number:
        return call.echoed(bytes(level.seed_bytes))
    if level.number in call.state.locked_until_s:
        return Nrc.TIME_DELAY_NOT_EXPIRED
    seed = call.moment.chance[: level.seed_bytes].ljust(level.seed_bytes, b"\x5a")
    if not any(seed):
        seed = bytes(level.seed_bytes - 1) + b"\1"  # zeros say that it is unlocked
    return call.echoed(seed, replace(call.state, seed_level=level.number, seed=seed))


def _take_key(call: Call, level: SecurityLevel) -> Result:
    if len(call.payload) != 2 + level.seed_bytes:
        return Nrc.INCORRECT_LENGTH
    if call.state.seed_level != level.number:
        return Nrc.REQUEST_SEQUENCE_ERROR
    state = replace(call.state, seed_level=0, seed=b"")
    if call.payload[2:] == key_of(level, call.state.seed):
        others = {number: count for number, count in state.wrong_keys.items() if number != level.number}
        return call.echoed(state=replace(state, unlocked=level.number, wrong_keys=others))
    count = state.wrong_keys.get(level.number, 0) + 1
    state = replace(state, wrong_keys={**state.wrong_keys, level.number: count})
    if count < level.most_attempts:
        return call.refused(Nrc.INVALID_KEY, state)
    until_s = {**state.locked_until_s, level.number: call.moment.t_s + level.delay_s}
    return call.refused(Nrc.EXCEEDED_NUMBER_OF_ATTEMPTS, replace(state, locked_until_s=until_s))
