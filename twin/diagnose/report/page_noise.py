"""The page's table of the instruments: how noisy each is, and how its noise follows the height."""

from __future__ import annotations

import html
from collections.abc import Sequence

from twin.diagnose.evidence.noise_levels import to_json
from twin.diagnose.report.sentences import quantity
from twin.diagnose.result import Diagnosis
from twin.page import paragraph, table

_SHOWN = 3  # recordings by name


def instruments(found: Diagnosis) -> str:
    """The noise of each instrument, or that each channel has one."""
    noise = found.fit_evidence.noise
    if noise is None:
        return paragraph("Noise: each channel is equally noisy in all recordings, as far as they can tell.")
    rows, over = [], []
    for name, channel in to_json(noise, (found.floor.sigma_i_c_a, found.floor.sigma_x_m)).items():
        unit = channel["unit"]
        rows += [
            [
                name,
                html.escape(_listed(one["recordings"])),
                "in flight" if one["in_flight"] else "at rest, captures",
                f"{quantity(one['sigma'], unit)} &plusmn; {100.0 * one['relative_std']:.2g} %",
            ]
            for one in channel["instruments"]
        ]
        if channel["over_height"]:
            levels = [
                f"{quantity(one['sigma'], unit)} at {quantity(one['x_m'], 'm')}" for one in channel["over_height"]
            ]
            over.append(f"The noise of {name} follows the height: {', '.join(levels)}.")
    return paragraph("Noise (standard deviation) as the readings themselves show it, without a model:") + (
        table(["channel", "recordings", "where", "noise"], rows) + "".join(paragraph(line) for line in over)
    )


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
