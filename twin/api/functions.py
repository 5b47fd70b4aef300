"""Identify, validate, diagnose, predict, design: the functions behind the commands of `board51`.

Each takes files or objects read from them.  The computations are in the packages of the same names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from protocol.campaign import Campaign
from protocol.errors import UsageError
from twin.api.results import Designed, Diagnosed, FrequencyResponses, Identified, Predicted, Validated
from twin.model.parameters import NAME_REMEDY, Model, name_problem
from twin.settings.diagnosis import MIN_SHARE

if TYPE_CHECKING:
    from twin.control_design.board import Converters
    from twin.control_design.design import Design
    from twin.diagnosis.equilibria.diagnosis import StaticDiagnosis
    from twin.diagnosis.options import Options
    from twin.diagnosis.result import Diagnosis
    from twin.frequency.bode import Bode

Progress = Callable[[str], None]


def _silent(_: str) -> None:
    return


def identify(
    campaign: Campaign | Path | str, *, name: str = "", data: Path | str | None = None, progress: Progress = _silent
) -> Identified:
    """Identify K_A, T_A, K_c and b, and the noise levels, from the recordings with use = "fit".

    Args:
        campaign: campaign.toml, its folder, or the result of `Campaign.load`.
        name: of the model, for people; empty: plant and day of the recordings.
        data: folder of the recordings, if it is not that of the campaign.
        progress: is called with lines of progress.

    Returns:
        The model in SI units, with warnings.

    Raises:
        DataError: a file is missing, unreadable or implausible.
        ConfigError: a key of the campaign is wrong.
        UsageError: the name is too long or not printable.
    """
    from twin.identification import pipeline

    if problem := name_problem(name):
        raise UsageError(f"--name {problem}", remedy=NAME_REMEDY)
    result = pipeline.identify(_campaign(campaign), data=_path(data), progress=progress)
    model = replace(result.model, provenance={"name": name} | dict(result.model.provenance)) if name else result.model
    return Identified(model=model, usable=result.usable, warnings=result.warnings, details=result)


def validate(
    campaign: Campaign | Path | str,
    model: Model | Path | str,
    *,
    data: Path | str | None = None,
    progress: Progress = _silent,
) -> Validated:
    """Validate a model on the recordings with use = "judge".

    Args:
        campaign: campaign.toml, its folder, or the result of `Campaign.load`.
        model: a model, a model file, or the name of a shipped model.
        data: folder of the recordings, if it is not that of the campaign.
        progress: is called with lines of progress.

    Returns:
        The verdict, and the prediction errors over the horizon as arrays of shape (n,), m.

    Raises:
        DataError: a file is missing, unreadable or implausible, or the model is of another rig.
        ConfigError: a key of the campaign is wrong.
    """
    import numpy as np

    from twin.frequency.bode import bode_of
    from twin.validation import verdict
    from twin.validation.source import chosen, sources_of

    campaign, model = _campaign(campaign), _model(model)
    verdict.check_same_rig(campaign, model)
    progress("reading the recordings")
    sources, messages = sources_of(campaign, model, data=_path(data))
    result = verdict.validate_sources(sources, model, messages=messages, progress=progress)
    progress("frequency responses")
    flown, _ = chosen([source for source in sources if source.record.kind == "closed-loop"])
    return Validated(
        passed=result.passed,
        answer=result.answer(),
        failures=tuple(result.failures()),
        notes=result.notes,
        horizon_s=np.array([row.horizon_s for row in result.ahead], dtype=np.float64),
        rmse_m=np.array([row.rmse_m for row in result.ahead], dtype=np.float64),
        floor_m=np.array([row.floor_m for row in result.ahead], dtype=np.float64),
        details=result,
        responses=_answered(bode_of(flown, model)),
    )


def bode(
    campaign: Campaign | Path | str, model: Model | Path | str, *, data: Path | str | None = None
) -> FrequencyResponses:
    """Compare a model with the frequency responses of a campaign's flights in closed loop.

    Args:
        campaign: campaign.toml, its folder, or the result of `Campaign.load`.
        model: a model, a model file, or the name of a shipped model.
        data: folder of the recordings, if it is not that of the campaign.

    Returns:
        The verdict in words; responses, margins and tests are in its `details` and `to_json()`.

    Raises:
        DataError: a file is missing, unreadable or implausible, or the model is of another rig.
        ConfigError: a key of the campaign is wrong.
    """
    from twin.frequency.bode import bode_of
    from twin.validation.source import sources_of
    from twin.validation.verdict import check_same_rig

    campaign, model = _campaign(campaign), _model(model)
    check_same_rig(campaign, model)
    sources, messages = sources_of(campaign, model, data=_path(data), spare=True)
    flown = [source for source in sources if source.record.kind == "closed-loop"]
    return _answered(bode_of(flown, model, messages=messages))


def diagnose(
    campaign: Campaign | Path | str,
    *,
    model: Model | Path | str | None = None,
    data: Path | str | None = None,
    quick: bool = False,
    share: float = MIN_SHARE,
    experiments: bool | None = None,
    free_form: bool | None = None,
    without: Sequence[str] = (),
    seed: int = 0,
    workers: int = 2,
    budget: float | None = None,
    progress: Progress = _silent,
) -> Diagnosed:
    """Name the physical causes of a model's errors, and extend the model by them.

    Args:
        campaign: campaign.toml, its folder, or the result of `Campaign.load`.
        model: the model to diagnose: a model, a model file, or the name of a shipped one; None: the paper's model,
            fitted to the campaign.
        data: folder of the recordings, if it is not that of the campaign.
        quick: use fewer candidates and the first seconds of each flight; confidence is then not calibrated.
        share: smallest part of the deviance above the noise floor that a cause must explain, 0 to 1.
        experiments: whether to find the experiment that separates equivalent causes; None: if not `quick`.
        free_form: whether to model what is left by smooth curves; None: where more than noise is left, if not `quick`.
        without: names of causes that the catalogue is to lack: does the answer then say that the cause is unknown?
        seed: of the random generator for the bootstrap.
        workers: threads; the result does not depend on it.
        budget: largest amount of computation, millions of filter steps; the answer is the same on any machine.
        progress: is called with lines of progress.

    Returns:
        Verdict, causes, extended model (SI units), and residuals as arrays.

    Raises:
        DataError: a file is missing, unreadable or implausible, there is too little data, or the model is of another
            plant.
        ConfigError: a key of the campaign is wrong.
        UsageError: `share` or `budget` is out of range, or a name of `without` is not in the catalogue.
    """
    from twin.diagnosis.options import Options
    from twin.inference.budget import MILLION

    _check_options(share, budget, without)
    where = campaign.where if isinstance(campaign, Campaign) else str(campaign)
    campaign = _campaign(campaign)
    options = Options(
        model=None if model is None else _model(model),
        quick=quick,
        share=share,
        experiments=experiments,
        free_form=free_form,
        without=tuple(without),
        seed=seed,
        workers=workers,
        budget=None if budget is None else budget * MILLION,
        say=progress,
    )
    return _diagnosed(campaign, options, _path(data), where)


def _check_options(share: float, budget: float | None, without: Sequence[str]) -> None:
    from twin.model.causes.catalogue import SEARCHED

    if not 0.0 < share <= 1.0:
        raise UsageError(f"--share is {share:g}", remedy="Give a part of 1, as 0.2")
    if budget is not None and not 0.0 < budget < math.inf:
        raise UsageError(f"--budget is {budget:g}", remedy="Give millions of filter steps, as 600")
    searched = sorted(cause.name for cause in SEARCHED)
    if unknown := [name for name in without if name not in searched]:
        raise UsageError(
            f"--without {unknown[0]}: not a cause that diagnose selects", remedy=f"Choose from {', '.join(searched)}"
        )


def _diagnosed(campaign: Campaign, options: Options, data: Path | None, where: str) -> Diagnosed:
    from twin.diagnosis import pipeline
    from twin.diagnosis.equilibria.diagnosis import diagnose_static, is_static
    from twin.diagnosis.equilibria.to_json import sentence_of
    from twin.diagnosis.residuals.summary import summarise

    details: Diagnosis | StaticDiagnosis
    if is_static(campaign):
        details = static = diagnose_static(campaign, data=data, model=options.model, say=options.say)
        sentence, causes, residuals = sentence_of(static), [member.name for member in static.members], None
    else:
        details = result = pipeline.diagnose(campaign, options, data=data)
        sentence, causes = result.sentence, [cause.name for cause in result.causes]
        options.say("what it gets wrong, before and after")
        residuals = summarise(result, campaign.controller, quick=options.quick, seed=options.seed)
    return Diagnosed(
        verdict=details.verdict,
        sentence=sentence,
        causes=tuple(causes),
        extended=details.extended,
        warnings=tuple(details.warnings),
        details=details,
        residuals=residuals,
        where=where,
    )


def predict(
    model: Model | Path | str,
    recording: Path | str,
    *,
    horizon_samples: int = 10,
    campaign: Campaign | Path | str | None = None,
    data: Path | str | None = None,
    board: str | None = None,
) -> Predicted:
    """Predict each reading of x from the readings up to N samples earlier and the measured u_c.

    Args:
        model: a model, a model file, or the name of a shipped model.
        recording: CSV (also .gz), MATLAB or MCAP.
        horizon_samples: horizon N in samples, 1 or more.
        campaign: campaign with the columns and skip_s of the recording; None: default columns.
        data: folder of the recordings, if it is not that of the campaign.
        board: board to use in a log of several boards.

    Returns:
        Times in s, readings and predictions in m, arrays of shape (n,).

    Raises:
        DataError: a file is missing, unreadable or implausible, or is not a recording of the campaign.
        UsageError: the horizon is below 1.
    """
    from twin import prediction
    from twin.readers.campaign import read_flight

    if horizon_samples < 1:
        raise UsageError(f"--horizon {horizon_samples}", remedy="Give a number of samples from 1")
    listed = None if campaign is None else _campaign(campaign)
    record = read_flight(Path(recording), listed, data=_path(data), board=board)
    result = prediction.predict(_model(model), record, horizon_samples)
    return Predicted(
        recording=record.name,
        horizon_samples=result.ahead,
        horizon_s=result.ahead * result.interval_s,
        t_s=result.t,
        x_m=result.x,
        x_hat_m=result.x_hat,
        rmse_m=result.rmse_m,
        details=result,
    )


def design(
    model: Model | Path | str,
    *,
    x_m: float | None = None,
    law: Literal["lqi", "pid"] = "lqi",
    sample_time_s: float = 2e-3,
    Q: tuple[float, float, float, float] | None = None,
    R: float | None = None,
    settling_time_s: float | None = None,
    converters: Converters | None = None,
    u_max_v: float = 5.0,
    with_observer: bool = False,
    seed: int = 1,
    before: Path | str | None = None,
) -> Designed:
    """Design LQI (eq. 16-19) or PID gains, and analyse the loop that the board will run.

    Args:
        model: a model, a model file, or the name of a shipped model.
        x_m: operating point, m, up from the bottom stop; None: mid-travel.
        law: control law of the board.
        sample_time_s: T_s, s.
        Q: weights of i_c (1/A^2), x (1/m^2), speed (s^2/m^2), integral (1/(m s)^2); None: Bryson's rule.
        R: weight of u_c, 1/V^2; None: Bryson's rule.
        settling_time_s: for Bryson's rule: longest duration of an error, s.
        converters: size of one count of each signal; None: those of the paper's board.
        u_max_v: upper limit of the input, V.
        with_observer: whether to compare with a Kalman filter, which the board cannot run.
        seed: of the random generator that draws parameters from their intervals.
        before: controller file of the gains to be replaced, whose margins are then in the result; None: none.

    Returns:
        Gains, shape (4,), SI units, with poles, margins and robustness.

    Raises:
        DataError: K_A or K_c of the model is a placeholder, or the file is missing.
        UsageError: an argument is out of range, the weights have no solution, or a gain exceeds the board's format.
    """
    from twin.control_design import design as work
    from twin.control_design.controller_file import read_controller

    specification = work.Specification(
        law=law,
        x_m=x_m,
        sample_time_s=sample_time_s,
        Q=Q,
        R=R,
        settling_time_s=settling_time_s,
        converters=converters,
        u_max_v=u_max_v,
        with_observer=with_observer,
        seed=seed,
        before=None if before is None else read_controller(Path(before)),
    )
    return _designed(work.design(_model(model), specification))


def _designed(result: Design) -> Designed:
    import numpy as np

    return Designed(
        gains=np.array(result.gains, dtype=np.float64),
        poles=result.board.poles,
        stable=result.board.stable,
        warnings=result.warnings,
        details=result,
    )


def _answered(result: Bode) -> FrequencyResponses:
    return FrequencyResponses(
        explains=result.verdict.explains, answer=result.verdict.sentence, notes=result.notes, details=result
    )


def _campaign(campaign: Campaign | Path | str) -> Campaign:
    return campaign if isinstance(campaign, Campaign) else Campaign.load(campaign)


def _path(path: Path | str | None) -> Path | None:
    return None if path is None else Path(path)


def _model(model: Model | Path | str) -> Model:
    return model if isinstance(model, Model) else Model.load(model)
