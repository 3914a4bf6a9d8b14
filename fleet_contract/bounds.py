"""What a number of a message can be: bounds by the unit in which the name of its field ends.

They are generous, for a number that is merely strange is worth keeping. No sum, square or difference of numbers within
them leaves what a database counts with.
"""

import re
from typing import Final

MOST_MU: Final = 1e4  # friction coefficients are below 1; a fit that knows little finds some hundred
_FAR: Final = 1e19  # of a number that has a name of its sender's alone: any of 64 bits; nothing is summed

# The end of a name, least, most; the first that fits counts.
_BY_NAME: Final = tuple(
    (re.compile(f"(?:{end})$"), least, most)
    for end, least, most in (
        (r"(?:^|_)mu(?:_[cs])?", -MOST_MU, MOST_MU),  # and its standard deviations and changes
        ("_bus_ns", -(4 * 10**18), 4 * 10**18),  # [ns] 1843 to 2096: a difference has 64 bits
        ("_count|^number|^blocks_as_one", 0, 10**9),  # a gear change each second for 30 years
        ("_gear", 0, 100),  # trucks have 18
        ("_m_s2|_m_s3", -1e6, 1e6),  # acceleration and jerk of a car: a crash has 1e3 m/s2 and 1e5 m/s3
        ("_rad_s2|_rad_s|_rad|_hz", -1e7, 1e7),  # 1e5 rad/s burst any gearbox; 1e4 rad/s within 1 ms; 1e3 rad/s for 1 h
        ("_s_rad", -1e7, 1e7),  # a slope: the whole friction within 1e-7 rad/s
        ("_s", -1e9, 1e9),  # 30 years
        ("_k", 0, 1e4),  # no metal is solid or liquid at 10,000 K
        ("_j", -1e9, 1e9),  # a truck of 40 t at 100 km/h has 1.5e7 J
        ("_pa", -1e9, 1e9),  # 10,000 bar; a transmission has 30
        ("_nm", -1e6, 1e6),  # the largest diesel engine of a truck gives 4e3 N m
        ("_m", 0, 1e10),  # 10 million km
        ("_ratio|^change|^std|^expected", -1e9, 1e9),  # any unit above: a change of pressure [Pa] is the largest
        ("", -_FAR, _FAR),
    )
)


def bounded(part: object, name: str = "") -> object:
    """Return a part of a JSON Schema in which each number has bounds: its own, or those by its name if narrower."""
    if isinstance(part, list):
        return [bounded(item, name) for item in part]
    if not isinstance(part, dict):
        return part
    made = {key: bounded(value, name if key == "items" else key) for key, value in part.items()}
    kinds = part.get("type")
    if "number" not in (kinds := kinds if isinstance(kinds, list) else [kinds]) and "integer" not in kinds:
        return made
    least, most = next((least, most) for end, least, most in _BY_NAME if end.search(name))
    return made | {"minimum": max(least, part.get("minimum", least)), "maximum": min(most, part.get("maximum", most))}
