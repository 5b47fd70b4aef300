"""Converts a file with gains (`board51 design --json` or `--out`, or the same keys in TOML) to a command.  Pure.

Rule: the complete file is checked before any part is shown: the screen shows exactly what would be sent.
"""

from __future__ import annotations

import math
import sys
from typing import Any

from google.protobuf.json_format import MessageToDict

from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError, UsageError
from protocol.files import parse_json, parse_toml

MAX_BYTES = 64_000
_REMEDY = "Take one that board51 design wrote"
LAW_OF_NAME = {"lqi": pb.LAW_LQI, "pid": pb.LAW_PID}
NAMES = {"lqi": ("k_i", "k_x", "k_v", "k_int"), "pid": ("k_p", "k_int", "k_d", "")}
UNITS = {"lqi": ("V/A", "V/m", "V s/m", "V/(m s)"), "pid": ("V/m", "V/(m s)", "V s/m", "")}
_POINT = ("i_0_a", "x_0_m", "u_0_v")


def parse_gains(data: bytes, parameters: pb.Parameters | None) -> pb.SetGains:
    """The gains in a file.

    Args:
        data: of the file.
        parameters: of the board that shall get them; a file made for another T_s or range is refused.

    Raises:
        DataError: says which key, what it holds, and what belongs there.
    """
    table = _table(data)
    law = table.get("law")
    if not isinstance(law, str) or law not in NAMES:
        raise DataError(f"law is {law!r}", remedy='Write law = "lqi" or "pid"; board51 design writes such a file')
    gains = table.get("gains")
    if not isinstance(gains, list) or len(gains) not in (3, 4) or not all(map(_is_number, gains)):
        problem = f"gains is {str(gains)[:80]}"
        raise DataError(problem, remedy=f"Give four finite numbers: {', '.join(n or '0' for n in NAMES[law])}")
    point = table.get("operating_point")
    if not isinstance(point, dict) or not all(_is_number(point.get(name)) for name in _POINT):
        problem = "operating_point is not complete"
        raise DataError(problem, remedy=f"Give {', '.join(_POINT)} as finite numbers, in SI units")
    if parameters is not None:
        _check_board(table, float(point["x_0_m"]), parameters)
    return pb.SetGains(
        law=LAW_OF_NAME[law],
        gains=[*map(float, gains), *[0.0] * (4 - len(gains))],
        **{name: point[name] for name in _POINT},
    )


def rows(gains: pb.SetGains, parameters: pb.Parameters | None) -> list[dict[str, str]]:
    """Return the rows to show before the gains are sent: name, new value, value on the board, unit."""
    law = "pid" if gains.law == pb.LAW_PID else "lqi"
    same = parameters is not None and parameters.law == gains.law
    old = list(parameters.gains) if parameters is not None and same else []
    table = [
        {
            "name": name,
            "new": f"{new:.6g}",
            "now": f"{old[n]:.6g}" if n < len(old) else text_of("gains.other_law"),
            "unit": unit,
        }
        for n, (name, unit, new) in enumerate(zip(NAMES[law], UNITS[law], gains.gains, strict=True))
        if name
    ]
    for name, field, unit, scale in (
        ("i_0", "i_0_a", "A", 1.0),
        ("x_0", "x_0_m", "mm", 1e3),
        ("u_0", "u_0_v", "V", 1.0),
    ):
        new, now = (math.nan if of is None else getattr(of, field) * scale for of in (gains, parameters))
        table.append({"name": name, "new": f"{new:.4g}", "now": f"{now:.4g}", "unit": unit})
    return table


def command_of(gains: pb.SetGains) -> dict[str, Any]:
    """Return the command that sets these gains, as protobuf's JSON: what the page shows is what it sends."""
    sent = MessageToDict(gains, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)
    return {"set_gains": sent}


def _table(data: bytes) -> dict[str, Any]:
    if len(data) > MAX_BYTES:
        raise DataError(f"The file has {len(data)} bytes", remedy=f"A file of gains has at most {MAX_BYTES}")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        raise DataError("The file is not UTF-8 text", remedy=_REMEDY) from None
    parse = parse_json if text.lstrip().startswith("{") else parse_toml
    try:
        table = parse(text, where="the file")
    except UsageError as error:
        raise DataError(f"The file is neither JSON nor TOML ({error.problem})", remedy=_REMEDY) from None
    if not isinstance(table, dict):
        raise DataError("The file holds no table of keys", remedy=_REMEDY)
    return table


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _check_board(table: dict[str, Any], x_0_m: float, parameters: pb.Parameters) -> None:
    sample_time_s = table.get("sample_time_s", parameters.sample_time_s)
    if not _is_number(sample_time_s) or abs(sample_time_s - parameters.sample_time_s) > 1e-6 * parameters.sample_time_s:
        raise DataError(
            f"The gains are for T_s = {str(sample_time_s)[:20]} s, the board runs at {parameters.sample_time_s:g} s",
            remedy=f"Use `board51 design --sample-time {parameters.sample_time_s:g}`",
        )
    if table.get("stable") is False:
        raise DataError("The loop is unstable on its own model", remedy="Choose other weights in board51 design")
    if not parameters.x_ref_min_m <= x_0_m <= parameters.x_ref_max_m:
        raise DataError(
            f"x_0 = {x_0_m * 1e3:g} mm is outside the board's references,"
            f" {parameters.x_ref_min_m * 1e3:g} .. {parameters.x_ref_max_m * 1e3:g} mm",
            remedy="Choose another operating point",
        )
