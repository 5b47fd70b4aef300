"""The designs of a campaign: new gains for its rig, and one flight before and after them.

DATA/campaigns/<campaign>/designs/<date>-<time>/   model.json, before.json (the gains on the board then),
controller.json and analysis.json of `design`,
what_if.json, what_if.html: the forecast of a flight
.../flight/   the flight that followed, a campaign of one experiment
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.views.hmi.model.campaigns import CampaignFolder, read_table
from gateway.views.hmi.texts import text_of, texts_of
from protocol.bus import board51_pb2 as pb

DESIGNS, FLIGHT, EXPERIMENT = "designs", "flight", "steps"
_SAME = 1e-4  # relative difference of gains that count as equal; a new design changes them by far more
# Without these keys a file is damaged.
_ANALYSIS = {"law", "on_board", "operating_point", "sample_time_s", "loops", "causes", "warnings"}
_FORECAST = {"answer", "figures", "lost", "notes"}
# Factors from SI to the units of the texts under flight_figure.
_FACTORS = {"overshoot": 100.0, "settling_s": 1e3, "rise_s": 1e3, "effort_v2_s": 1.0, "rms_m": 1e6, "at_limit": 100.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignFolder:
    """The folder of one design."""

    path: Path
    made: str  # date and time, as a page shows them
    model: dict[str, Any]  # model.json
    analysis: dict[str, Any]  # analysis.json; empty if the design gave no gains
    forecast: dict[str, Any]  # what_if.json; empty if there is none yet

    @property
    def controller(self) -> Path:
        """Return the file of the gains."""
        return self.path / "controller.json"

    @property
    def report(self) -> Path:
        """Return the page of the forecast."""
        return self.path / "what_if.html"

    @property
    def flown(self) -> Path | None:
        """Return the recording of the flight that followed."""
        path = self.path / FLIGHT / f"{EXPERIMENT}.mcap"
        return path if path.is_file() else None

    @property
    def margins(self) -> list[tuple[str, str, str]]:
        """Return the rows to show: (title, value with the old gains, value with the new gains)."""
        before, after = self.analysis.get("before") or {}, self.analysis["loops"][2]
        rows = [(text_of("design.gain_margin"), _range(before), _range(after))]
        for key, name, factor in (
            ("design.phase_margin", "phase_margin_deg", 1.0),
            ("design.delay_margin", "delay_margin_s", 1e3),
            ("design.noise_x", "x_rms_m", 1e6),
            ("design.noise_u", "u_rms_v", 1e3),
        ):
            rows.append((text_of(key), _cell(before, name, factor), _cell(after, name, factor)))
        return rows

    @property
    def figures(self) -> list[tuple[str, str, str, str]]:
        """Return the rows to show: title, the recorded flight, the forecast, the flight that followed."""
        named = {str(figure["name"]): figure for figure in self.forecast["figures"]}
        titles = texts_of("flight_figure")
        return [(titles[name], *_figure(named[name], factor)) for name, factor in _FACTORS.items() if name in named]

    def is_on(self, parameters: pb.Parameters | None) -> bool:
        """Return whether a board has the gains of this design."""
        if not self.analysis or parameters is None or (parameters.law == pb.LAW_PID) != (self.analysis["law"] == "pid"):
            return False
        gains, x_0_m = self.analysis["on_board"], self.analysis["operating_point"]["x_0_m"]
        if abs(x_0_m - parameters.x_0_m) > 2.0 * abs(parameters.x_lsb_m):
            return False
        return len(gains) == len(parameters.gains) and all(
            math.isclose(a["value"], b, rel_tol=_SAME) for a, b in zip(gains, parameters.gains, strict=True)
        )


def newest_design(campaign: CampaignFolder | None) -> DesignFolder | None:
    """Return the newest design of a campaign; None if there is none."""
    folders = [] if campaign is None else sorted(path for path in (campaign.path / DESIGNS).glob("*") if path.is_dir())
    if not folders:
        return None
    path = folders[-1]
    day, _, clock = path.name.partition("-")
    analysis, forecast = read_table(path / "analysis.json"), read_table(path / "what_if.json")
    return DesignFolder(
        path=path,
        made=f"{day[:4]}-{day[4:6]}-{day[6:]} {clock[:2]}:{clock[2:4]}",
        model=read_table(path / "model.json"),
        analysis=analysis if _ANALYSIS <= set(analysis) else {},
        forecast=forecast if _FORECAST <= set(forecast) else {},
    )


def flight_before(campaign: CampaignFolder, design: DesignFolder) -> Path | None:
    """Return the newest recording of the experiment before a design: of an earlier design, else of the campaign."""
    recording = campaign.path / f"{EXPERIMENT}.mcap"
    all_flown = sorted((campaign.path / DESIGNS).glob(f"*/{FLIGHT}/{EXPERIMENT}.mcap"))
    earlier = [path for path in all_flown if path.parent.parent.name < design.path.name]
    return earlier[-1] if earlier else recording if recording.is_file() else None


def _cell(loop: dict[str, Any], name: str, factor: float) -> str:
    if not loop:
        return text_of("design.unknown")
    if not loop["stable"]:
        return text_of("design.unstable")
    value = loop[name]
    return text_of("design.no_limit") if value is None else f"{value * factor:.3g}"


def _range(loop: dict[str, Any]) -> str:
    if not loop or not loop["stable"]:
        return _cell(loop, "", 1.0)
    low, high = loop["gain_margin"]
    end = text_of("design.no_limit") if high is None else f"{high:.2f}"
    return text_of("design.range", low=f"{low:.2f}", high=end)


def _figure(figure: dict[str, Any], factor: float) -> tuple[str, str, str]:
    recorded, value, flown = (_number(figure.get(name), factor) for name in ("recorded", "value", "flown"))
    low, high = (_number(end, factor) for end in figure["ci95"])
    if figure["value"] is None:
        return recorded, value, flown
    return recorded, text_of("design.interval", value=value, low=low, high=high), flown


def _number(value: float | None, factor: float) -> str:
    return text_of("design.unknown") if value is None else f"{value * factor:.3g}"
