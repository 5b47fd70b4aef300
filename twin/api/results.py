"""Results of the functions of `twin`: data, arrays, and their forms as JSON, HTML, figures and text."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocol.files import make_folder, writing
from twin.model.parameters import Model

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    from matplotlib.figure import Figure

    from twin.control_design.design import Design
    from twin.diagnosis.equilibria.diagnosis import StaticDiagnosis
    from twin.diagnosis.residuals.summary import Summary
    from twin.diagnosis.result import Diagnosis
    from twin.frequency.bode import Bode
    from twin.identification.result import Identification
    from twin.prediction import Prediction
    from twin.validation.verdict import Validation

    FloatArray = npt.NDArray[np.float64]


def as_text(data: Mapping[str, Any]) -> str:
    """Return JSON text in the format of the commands; raises ValueError for NaN."""
    return json.dumps(data, indent=2, allow_nan=False)


def write_text(path: Path, text: str) -> None:
    """Write a text file.  Raises UsageError if that is not possible."""
    with writing(path):
        path.write_text(text, encoding="utf-8")


def _save(folder: Path | str, texts: Mapping[str, str | Mapping[str, Any]]) -> None:
    """Write texts, and data as JSON, by the names of their files.  Raises UsageError."""
    make_folder(Path(folder))
    for name, text in texts.items():
        write_text(Path(folder) / name, text if isinstance(text, str) else as_text(text) + "\n")


def save_figures(figures: Mapping[str, Figure], folder: Path | str, kind: str) -> None:
    """Write each figure as a file of its name, of the kind png, pdf or svg.

    Raises:
        UsageError: the folder cannot be written.
    """
    make_folder(Path(folder))
    for name, figure in figures.items():
        path = Path(folder) / f"{re.sub(r'[^A-Za-z0-9]+', '-', name).strip('-')}.{kind}"
        with writing(path):
            figure.savefig(path)


@dataclass(frozen=True, slots=True, kw_only=True)
class Identified:
    """The model of a campaign."""

    model: Model  # K_A in A/V, T_A in s, K_c in N m^2/A^2, b in N s/m, with intervals and verdicts
    usable: bool  # whether a twin can use the model: the fit converged, K_A and K_c are known
    warnings: tuple[str, ...]
    details: Identification

    def to_json(self) -> dict[str, Any]:
        """Return the content of the model file."""
        return self.model.to_json()

    def table(self) -> str:
        """Return the result as a text table for a person."""
        from twin.identification.result import table

        return table(self.details)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrequencyResponses:
    """The answer to whether a model explains measured frequency responses."""

    explains: bool | None  # None: no flight is excited
    answer: str
    notes: tuple[str, ...]
    details: Bode

    def to_json(self) -> dict[str, Any]:
        """Return the content of bode.json."""
        from twin.frequency.report import to_dict

        return to_dict(self.details)

    def to_html(self, title: str = "") -> str:
        """Return the content of bode.html, self-contained."""
        from twin.frequency.report import to_html

        return to_html(self.details, title=title or f"Frequency responses of {self.details.model.plant.name}")

    def figures(self) -> dict[str, Figure]:
        """The responses by height, and the spectra of the residuals."""
        from twin.frequency import figures as draw

        drawn = {f"{height.x_m * 1e3:.2f} mm": draw.response_figure(height) for height in self.details.heights}
        if self.details.residuals:
            drawn["residuals"] = draw.residual_figure(self.details.residuals)
        return drawn

    def save(self, folder: Path | str, *, title: str = "") -> None:
        """Write bode.json and bode.html.

        Raises:
            UsageError: the folder cannot be written.
        """
        _save(folder, {"bode.json": self.to_json(), "bode.html": self.to_html(title)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Validated:
    """The answer to whether a model explains the recordings with use = "judge"."""

    passed: bool | None  # None: the flights are missing or too short for a verdict
    answer: str
    failures: tuple[str, ...]
    notes: tuple[str, ...]
    horizon_s: FloatArray  # of the predictions, s, shape (n,)
    rmse_m: FloatArray  # their error, m, shape (n,)
    floor_m: FloatArray  # error of a perfect model, m, shape (n,)
    details: Validation
    responses: FrequencyResponses  # does not affect `passed`: a simple answer of its own

    def to_json(self) -> dict[str, Any]:
        """Return the content of validation.json."""
        from twin.validation.report import to_dict

        tests = self.responses.to_json()["tests"]
        answer = {"explains": self.responses.explains, "answer": self.responses.answer, "tests": tests}
        return to_dict(self.details) | {"frequency_responses": answer}

    def to_html(self, title: str = "") -> str:
        """Return the content of report.html, self-contained."""
        from twin.frequency.report import section
        from twin.validation.report import to_html

        title = title or f"Validation on {self.details.model.plant.name}"
        return to_html(self.details, title=title, further=section(self.responses.details))

    def figures(self) -> dict[str, Figure]:
        """The paper's figures 7, 8, 11 and 12, prediction errors and residuals; those without data are left out."""
        from twin.validation.figures import loop_figure
        from twin.validation.report import drawn

        loop, travel_m = self.details.loop, self.details.model.plant.travel_m
        runs = () if isinstance(loop, str) else loop.runs
        loops = {f"closed loop {run.name}": loop_figure(run, travel_m) for run in runs}
        return {name: figure for name, (figure, _) in drawn(self.details).items()} | loops

    def save(self, folder: Path | str, *, title: str = "") -> None:
        """Write validation.json and report.html.

        Raises:
            UsageError: the folder cannot be written.
        """
        _save(folder, {"validation.json": self.to_json(), "report.html": self.to_html(title)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosed:
    """The causes of a model's errors, and the extended model."""

    verdict: str  # causes-found | partly-explained | model-adequate | unknown-cause | unfinished
    sentence: str  # the answer in words
    causes: tuple[str, ...]  # names of the catalogue, most important first; candidates if the verdict names no cause
    extended: Model  # the model with its causes, for any function that takes a model
    warnings: tuple[str, ...]
    details: Diagnosis | StaticDiagnosis  # StaticDiagnosis: the campaign has equilibria only
    residuals: Summary | None  # errors before and after the extension, as arrays; None for equilibria only
    where: str  # path of the campaign, for the report

    @property
    def offered(self) -> bool:
        """Return whether a twin gains by `extended`: it was judged, and it is not the reference itself."""
        return bool(self._static.extended.causes) if self.residuals is None else self._flown.offered

    def to_json(self) -> dict[str, Any]:
        """Return the content of diagnosis.json."""
        if self.residuals is None:
            from twin.diagnosis.equilibria import to_json as static

            return static.to_json(self._static)
        from twin.diagnosis import result
        from twin.diagnosis.residuals.summary import to_dict

        return result.to_json(self._flown) | {"show": to_dict(self.residuals)}

    def to_html(self, folder: Path | str = ".") -> str:
        """Return the content of report.html, self-contained; the commands at its end name `folder`."""
        if self.residuals is None:
            from twin.diagnosis.equilibria.page import page

            return page(self._static, f"What the model of {self.extended.plant.name} gets wrong at rest")
        from twin.diagnosis.report.page import to_html

        return to_html(self._flown, self.residuals, campaign=Path(self.where), out=Path(folder))

    def figures(self) -> dict[str, Figure]:
        """The errors before and after the extension: over the horizon, in time, by regime, as force, as spectrum."""
        if self.residuals is None:
            from twin.diagnosis.equilibria.page import figure

            return {"points": figure(self._static)}
        from twin.diagnosis.report import figures as draw

        show = self.residuals
        drawn: dict[str, Figure] = {}
        if show.ahead:
            drawn["prediction"] = draw.ahead_figure(show.ahead)
        if show.piece is not None:
            drawn["trace"] = draw.piece_figure(show.piece)
            drawn["error"] = draw.error_figure(show.piece, show.floor_m)
        drawn |= {f"error by {entry.title}": draw.regime_figure(entry, show.floor_m) for entry in show.regimes}
        drawn |= {
            f"{entry.residual_unit} over {entry.title}": draw.curve_figure(entry)
            for entry in (*show.force, *show.current)
        }
        if show.spectrum is not None:
            drawn["spectrum"] = draw.spectrum_figure(show.spectrum)
        if not isinstance(show.steps, str):
            drawn["steps"] = draw.steps_figure(show.steps)
        return drawn

    def summary(self, saved_in: Path | None = None) -> str:
        """A summary in a few lines; `saved_in`: the folder of the files, which it then names."""
        lines = [self.sentence]
        if self.residuals is not None:
            from twin.diagnosis.report.quantities import percent
            from twin.diagnosis.report.sentences import sizes

            result = self._flown
            for cause in result.causes:
                equals = ", ".join(member.name for member in cause.indistinguishable_from)
                lines.append(
                    f"  {'' if result.holds(cause) else 'candidate '}{cause.name}: confidence {cause.confidence:.2f},"
                    f" explains {percent(cause.share_of_excess_explained)}"
                    + (f"; these data cannot tell it from {equals}" if equals else "")
                )
            for entry in result.minor_effects:
                lines.append(f"  seen, too small to be named: {entry.name} ({sizes(entry.name, entry.parameters)})")
        lines += [f"  ! {warning}" for warning in self.warnings]
        if saved_in is not None:
            source = "" if self.offered else f" ({self.extended.provenance.get('about', 'the reference')})"
            lines += [f"report   {saved_in / 'report.html'}", f"model    {saved_in / 'extended_model.json'}{source}"]
        return "\n".join(lines)

    def save(self, folder: Path | str) -> None:
        """Write diagnosis.json, report.html and extended_model.json.

        Raises:
            UsageError: the folder cannot be written.
        """
        make_folder(Path(folder))  # before the work on the page
        report, model = self.to_html(folder), self.extended.to_json()
        _save(folder, {"report.html": report, "diagnosis.json": self.to_json(), "extended_model.json": model})

    @property
    def _flown(self) -> Diagnosis:
        from twin.diagnosis.result import Diagnosis

        assert isinstance(self.details, Diagnosis)
        return self.details

    @property
    def _static(self) -> StaticDiagnosis:
        from twin.diagnosis.equilibria.diagnosis import StaticDiagnosis

        assert isinstance(self.details, StaticDiagnosis)
        return self.details


@dataclass(frozen=True, slots=True, kw_only=True)
class Predicted:
    """Predictions of the position N samples ahead, for all samples of a recording that can be predicted."""

    recording: str
    horizon_samples: int
    horizon_s: float
    t_s: FloatArray  # time, s, shape (n,)
    x_m: FloatArray  # readings, m, shape (n,)
    x_hat_m: FloatArray  # their predictions, m, shape (n,)
    rmse_m: float | None  # m; None without a prediction
    details: Prediction

    def to_json(self) -> dict[str, Any]:
        """The summary that the command prints."""
        result = self.details
        return {
            "recording": self.recording,
            "horizon_samples": self.horizon_samples,
            "horizon_s": self.horizon_s,
            "rmse_m": self.rmse_m,
            "count": len(self.x_m),
            "samples": result.samples,
            "left_out": dict(result.left_out),
            "notes": list(result.notes),
        }

    def figure(self) -> Figure:
        """Return x with its predictions, and their errors, over time."""
        from twin.page.figures import MEASURED, MODEL, grid, label

        figure, ((above,), (below,)) = grid(2, 1, height=6.0)
        above.plot(self.t_s, 1e3 * self.x_m, color=MEASURED, label="measured")
        above.plot(self.t_s, 1e3 * self.x_hat_m, color=MODEL, label=f"predicted {1e3 * self.horizon_s:.3g} ms ahead")
        below.plot(self.t_s, 1e6 * (self.x_m - self.x_hat_m), color=MODEL, label="measured minus predicted")
        label(above, "", "x [mm]")
        label(below, "t [s]", "error [µm]")
        return figure

    def to_csv(self) -> str:
        """Return the rows t, x, x_hat in s and m."""
        rows = zip(self.t_s.tolist(), self.x_m.tolist(), self.x_hat_m.tolist(), strict=True)
        return "t,x,x_hat\n" + "".join(f"{t:.9g},{x:.10g},{x_hat:.10g}\n" for t, x, x_hat in rows)

    def table(self) -> str:
        """Return the result as a text table for a person."""
        result = self.details
        horizon = f"{self.horizon_samples} samples ({1e3 * self.horizon_s:.3g} ms) ahead"
        lines = [f"{self.recording}: {len(self.x_m)} of {result.samples} samples predicted {horizon}"]
        if self.rmse_m is not None:
            lines.append(f"rmse of x  {self.rmse_m:.6g} m")
        return "\n".join([*lines, *(f"left out   {count:>7}  {why}" for why, count in result.left_out)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Designed:
    """A controller for the board, and the analysis of its loop."""

    gains: FloatArray  # in the order of the law, shape (4,); for LQI in V/A, V/m, V s/m, V/(m s)
    poles: npt.NDArray[np.complex128]  # of the board's loop, in z, largest first, shape (n,)
    stable: bool  # whether the board's loop is stable on the model
    warnings: tuple[str, ...]
    details: Design

    def to_json(self) -> dict[str, Any]:
        """The controller file: law, gains, operating point."""
        from twin.control_design.report import controller

        return controller(self.details)

    def report(self) -> dict[str, Any]:
        """The controller with its full analysis, in the form that the command prints."""
        from twin.control_design.report import everything

        return everything(self.details)

    def table(self) -> str:
        """Return the result as a text table for a person."""
        from twin.control_design.report import table

        return table(self.details)
