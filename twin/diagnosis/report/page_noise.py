"""The page's table of the instruments: how noisy each is, and how its noise follows the height."""

from __future__ import annotations

from collections.abc import Sequence

from twin.diagnosis.report.sentences import quantity
from twin.diagnosis.result import Diagnosis
from twin.evidence.noise_levels import colours_json, to_json

_MAX_NAMES = 3  # recordings by name


def instruments(diagnosis: Diagnosis) -> tuple[list[list[str]], list[str]]:
    """Return the rows of the instruments of each channel, none where each has one; sentences on heights."""
    rows: list[list[str]] = []
    sentences: list[str] = []
    noise = diagnosis.fit_evidence.noise
    if noise is None:
        return rows, sentences
    for name, channel in to_json(noise, (diagnosis.floor.sigma_i_c_a, diagnosis.floor.sigma_x_m)).items():
        unit = channel["unit"]
        rows += [
            [
                name,
                _listed(entry["recordings"]),
                "in flight" if entry["in_flight"] else "at rest, captures",
                f"{quantity(entry['sigma'], unit)} ± {100.0 * entry['relative_std']:.2g} %",
            ]
            for entry in channel["instruments"]
        ]
        if channel["over_height"]:
            levels = [
                f"{quantity(entry['sigma'], unit)} at {quantity(entry['x_m'], 'm')}" for entry in channel["over_height"]
            ]
            sentences.append(f"The noise of {name} follows the height: {', '.join(levels)}.")
    for name, colour in colours_json(noise).items():
        sigma, tau = quantity(colour["sigma"], "m" if name == "x" else "A"), quantity(colour["correlation_time_s"], "s")
        white = f"{100.0 * colour['white_share_of_variance']:.2g} %"
        sentences.append(
            f"The noise of {name} at rest is coloured: {sigma}, correlation time {tau}, {white} of it white."
        )
    return rows, sentences


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MAX_NAMES
    return ", ".join(names[:_MAX_NAMES]) + (f" and {more} more" if more > 0 else "")
