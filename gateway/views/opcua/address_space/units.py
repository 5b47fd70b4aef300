"""The unit of a field from the end of its name, as OPC UA wants it (UNECE Recommendation 20 codes).  Pure."""

from __future__ import annotations

from asyncua import ua

_NAMESPACE = "http://www.opcfoundation.org/UA/units/un/cefact"
# Longest ends first: x_ref_slew_m_s is a speed, not a time.
_UNITS: tuple[tuple[str, str, str, str], ...] = (
    ("_per_s", "C97", "1/s", "reciprocal second"),
    ("_percent", "P1", "%", "percent"),
    ("_m_s", "MTS", "m/s", "metre per second"),
    ("_ms", "C26", "ms", "millisecond"),
    ("_ns", "C47", "ns", "nanosecond"),
    ("_a", "AMP", "A", "ampere"),
    ("_m", "MTR", "m", "metre"),
    ("_v", "VLT", "V", "volt"),
    ("_s", "SEC", "s", "second"),
)
_OF_PARENT = frozenset({"error", "rolling_rmse", "rolling_mean"})  # of a signal's divergence: in the unit of the signal


def unit_of(field: str) -> ua.EUInformation | None:
    """The unit of a field such as `i_c_a` or `x_m.error`; None for a plain number."""
    parent, _, name = field.rpartition(".")
    if parent and name in _OF_PARENT:
        name = parent
    for end, code, symbol, words in _UNITS:
        if name.endswith(end):
            return ua.EUInformation(
                NamespaceUri=_NAMESPACE,
                UnitId=int.from_bytes(code.encode("ascii"), "big"),
                DisplayName=ua.LocalizedText(symbol),
                Description=ua.LocalizedText(words),
            )
    return None
