"""The page's table of the instruments: how noisy each is, and how its noise follows the height."""

from __future__ import annotations

from collections.abc import Sequence

from twin.diagnose.evidence.noise_levels import colours_json, to_json
from twin.diagnose.report.sentences import quantity
from twin.diagnose.result import Diagnosis

_SHOWN = 3  # recordings by name


def instruments(found: Diagnosis) -> tuple[list[list[str]], list[str]]:
    """Rows of the instruments of each channel, none where each has one; sentences on heights."""
    rows: list[list[str]] = []
    over: list[str] = []
    noise = found.fit_evidence.noise
    if noise is None:
        return rows, over
    for name, channel in to_json(noise, (found.floor.sigma_i_c_a, found.floor.sigma_x_m)).items():
        unit = channel["unit"]
        rows += [
            [
                name,
                _listed(one["recordings"]),
                "in flight" if one["in_flight"] else "at rest, captures",
                f"{quantity(one['sigma'], unit)} ± {100.0 * one['relative_std']:.2g} %",
            ]
            for one in channel["instruments"]
        ]
        if channel["over_height"]:
            levels = [
                f"{quantity(one['sigma'], unit)} at {quantity(one['x_m'], 'm')}" for one in channel["over_height"]
            ]
            over.append(f"The noise of {name} follows the height: {', '.join(levels)}.")
    for name, colour in colours_json(noise).items():
        sigma, tau = quantity(colour["sigma"], "m" if name == "x" else "A"), quantity(colour["correlation_time_s"], "s")
        white = f"{100.0 * colour['white_share_of_variance']:.2g} %"
        over.append(f"The noise of {name} at rest is coloured: {sigma}, forgotten within {tau} but for {white} of it.")
    return rows, over


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
