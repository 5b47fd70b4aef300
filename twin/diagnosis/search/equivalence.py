"""Equivalence classes: which other causes explain the data as well as a selected one.

    for each selected cause: try every other candidate in its place -> a better one replaces it; equals are its class

Rule: causes whose best fits differ by less than EQUIVALENT_GAIN of log-likelihood are one class (S 10).
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from functools import partial

from twin.diagnosis.search import periodic
from twin.diagnosis.search.candidate_fits import Trial, fit_candidates, renamed, same_as, steepness, within_range
from twin.diagnosis.search.candidate_starts import substitute_start
from twin.diagnosis.search.line_place import placed
from twin.diagnosis.search.score_test import screen
from twin.diagnosis.search.sensor_line import line_scores
from twin.diagnosis.search.state import Selection, fit_without, superfluous
from twin.diagnosis.search.task import Search
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import parameter_of, prior_spread, reinitialised
from twin.model.causes.catalogue import BY_NAME
from twin.settings import diagnosis as settings


def find_classes(search: Search, selection: Selection) -> Selection:
    """Find the class of each selected cause and the best candidate outside it.

    With `quick` and several causes, the class of the last cause is read from the trials of its round, without new fits.
    The other causes were selected while later ones were missing, so a few candidates are fitted for each.
    """
    criterion = search.criterion
    selection = replace(selection, classes={}, runner_up={})
    if len(selection.causes) > 1 and not search.quick:
        selection = selection.with_fits(criterion.each(partial(fit_without, criterion, selection), selection.causes))
    for cause in selection.causes:
        if search.quick and len(selection.causes) > 1 and _is_last(selection, cause):
            # The trials of its own round serve: they were fitted beside all other causes, as this was the last.
            selected = Trial(cause=cause, fit=selection.fit, gain=selection.gains[cause])
            same = same_as(cause) & {entry.name for entry in search.candidates}
            equals = [renamed(criterion, selected, other) for other in sorted(same)]
            equals = [trial for trial in equals if selected.gain - trial.gain < settings.EQUIVALENT_GAIN]
            equals += _equals_at_selection(selection, cause, same)
            selection = replace(
                selection,
                classes={**selection.classes, cause: tuple(equals)},
                runner_up={**selection.runner_up, cause: selection.gains[cause]},
            )
            continue
        selection, changed = _class_of(search, selection, cause)
        # Every class was found with the other causes fixed, so a change makes all of them stale.  Repairing only the
        # affected ones would need to know which causes interact.
        if changed:
            return find_classes(search, selection)
    return selection


def _refit_from_usual_forms(criterion: Criterion, fit: Fit, cause: str) -> Fit:
    """Return the better of `fit` and a fit that starts from the usual forms of all causes but `cause`.

    Beside the false cause that was replaced, the other forms had compensated for its errors.
    """
    free_shapes = [name for name in fit.free if math.isfinite(prior_spread(name)) and not name.startswith(cause + ".")]
    if not free_shapes:
        return fit
    start = reinitialised(fit.theta)
    for name in free_shapes:
        start = start.having(name, parameter_of(name).neutral)
    fit_anew = climb(criterion, start, fit.free)
    return fit_anew if fit_anew.loglik > fit.loglik else fit


def _is_last(selection: Selection, cause: str) -> bool:
    """Tell whether `cause` was selected last, by itself: its rivals were then fitted with all other causes."""
    last = next((step for step in reversed(selection.rounds) if step.selected), None)
    return last is not None and last.selected == cause and not last.partner


def _equals_at_selection(selection: Selection, cause: str, same: Collection[str]) -> list[Trial]:
    """Return the candidates that explained as much as the last cause when it was selected, without a further fit."""
    last = next(step for step in reversed(selection.rounds) if step.selected == cause)
    min_gain = max(trial.gain for trial in last.trials if trial.cause == cause) - settings.EQUIVALENT_GAIN
    rivals = (trial for trial in last.trials if trial.cause not in (*selection.causes, *same))
    return [trial for trial in rivals if trial.gain > min_gain and within_range(trial)]


def _replace_two(search: Search, selection: Selection, cause: str, trial: Trial) -> Selection | None:
    """Let `trial` replace `cause` and a second cause if it explains as much as both together; None if it does not.

    Two causes that imitate a third are never found superfluous one by one.
    """
    # The bar is that of the fit with both causes, less what a class allows: one cause in place of two has fewer
    # parameters, so equal likelihood suffices.
    min_loglik = selection.fit.loglik - settings.EQUIVALENT_GAIN
    # The weakest first: it is the likeliest to be superfluous, and the first that goes ends the search.
    remaining = sorted(set(selection.causes) - {cause, trial.cause}, key=lambda name: selection.gains[name])

    def less(other: str) -> Fit:
        free = tuple(name for name in trial.fit.free if not name.startswith(other + "."))
        return climb(search.criterion, reinitialised(trial.fit.theta.without(other, search.criterion.plant)), free)

    for other, fit in zip(remaining, search.criterion.each(less, remaining), strict=True):
        if fit.loglik > min_loglik:
            if trial.cause == cause:
                search.report(f"dropped: {other} ({cause} explains it)")
            else:
                search.report(f"{trial.cause} explains as much as {cause} and {other} together: it replaces them")
            causes = tuple(trial.cause if name == cause else name for name in selection.causes if name != other)
            gain = fit.loglik - selection.base.loglik
            gains = {name: selection.gains.get(name, gain) for name in causes}
            return replace(selection, causes=causes, fit=fit, gains=gains).with_fits([fit])
    return None


def _class_of(search: Search, selection: Selection, cause: str) -> tuple[Selection, bool]:
    """Find the class of `cause` with the other causes fixed; a candidate that explains more replaces it.

    Returns the selection, and True if two causes were replaced by one or if `cause` is superfluous; then all classes
    are found again.
    """
    criterion = search.criterion
    if len(selection.causes) == 1:
        current = selection.base
    else:
        current = fit_without(criterion, selection, cause)
        selection = selection.with_fits([current])
    selected = Trial(cause=cause, fit=selection.fit, gain=selection.fit.loglik - current.loglik)
    # A minor effect is judged by the floor of another model, which costs a run more.  So only a thorough search asks.
    is_needless = superfluous(search, selection, current) if search.thorough else selected.gain < settings.MIN_GAIN
    if is_needless and len(selection.causes) > 1:
        search.report(f"dropped: {cause} (the others explain it)")
        return selection.dropping(cause, current), True
    trials = placed(criterion, selected, _rivals(search, selection, current, selected))
    # The selected cause, too, may be at a local maximum.  So it is fitted again from the candidate's parameters before
    # the candidate replaces it.
    if trials and trials[0].gain > selected.gain + settings.EQUIVALENT_GAIN:
        selected = _refit_from(criterion, trials[0], selected)
        selection = replace(selection, fit=selected.fit)
    if trials and trials[0].gain > selected.gain + settings.EQUIVALENT_GAIN:
        search.report(f"{trials[0].cause} explains more than {cause} next to the others: it replaces it")
        selection = _exchanged(criterion, selection, cause, trials[0])
        trials, selected = [selected, *trials[1:]], trials[0]
    # (S 10).  All of them are reported, not the likeliest alone: by so small a lead chance decides.
    equals = tuple(trial for trial in trials if selected.gain - trial.gain < settings.EQUIVALENT_GAIN)
    behind = [trial.gain for trial in trials if selected.gain - trial.gain >= settings.EQUIVALENT_GAIN]
    selection = replace(
        selection,
        classes={**selection.classes, selected.cause: equals},
        runner_up={**selection.runner_up, selected.cause: selected.gain - max(behind, default=0.0)},
        gains={**selection.gains, selected.cause: selected.gain},
    )
    # Equals are examined, too: one of them may replace two causes where the selected one does not.
    for trial in (selected, *equals):
        smaller = (
            None if trial.cause in (cause, *same_as(cause)) else _replace_two(search, selection, selected.cause, trial)
        )
        if smaller is not None:
            return smaller, True
    return selection, False


def _exchanged(criterion: Criterion, selection: Selection, cause: str, best: Trial) -> Selection:
    """Return the selection with the candidate of `best` instead of `cause`."""
    causes = tuple(best.cause if name == cause else name for name in selection.causes)
    if periodic.CAUSE.name in causes:
        fit = periodic.fit_phases(criterion, best.fit, settings.PASSES)
    else:
        fit = _refit_from_usual_forms(criterion, best.fit, best.cause)
    gains = {name: gain for name, gain in {**selection.gains, best.cause: best.gain}.items() if name != cause}
    return replace(selection, causes=causes, fit=fit, gains=gains)


def _rivals(search: Search, selection: Selection, current: Fit, selected: Trial) -> list[Trial]:
    """Fit the candidates that may be in the class of a selected cause; best first.

    Args:
        search: the data and the candidates.
        selection: the selected causes.
        current: the fit without the cause of `selected`.
        selected: the cause, with its fit and gain.
    """
    criterion, cause = search.criterion, BY_NAME[selected.cause]
    remaining = [entry for entry in search.candidates if entry.name not in selection.causes]
    # A cause with the same effect on the samples is an equal without a fit.
    same = same_as(cause.name) & {entry.name for entry in remaining}
    known: tuple[Trial, ...] = ()
    if len(selection.causes) == 1:
        # The first round began at the model without this cause, so its scores and trials are already this comparison.
        scores, known = [*selection.rounds[0].scores], selection.rounds[0].trials
    else:
        scores = screen(criterion, current.theta, current.free, [*remaining, cause])
        if "line" in cause.detector:
            scores += line_scores(criterion, current, remaining)
            asks_force = any(entry.name == periodic.CAUSE.name for entry in remaining)
            if asks_force and (force := periodic.score(criterion, current.theta)) is not None:
                scores.append(force)
    gain = next((score.gain for score in scores if score.cause == cause.name), 0.0)
    similar = {score.cause for score in scores if score.gain > settings.SIMILAR_SCORE * gain}
    # Causes of one family are similar by their physics, whatever their scores at this fit are.
    similar |= {entry.name for entry in search.candidates if entry.family == cause.family}
    decided = {cause.name, *same, *(trial.cause for trial in known)}
    scores = [score for score in scores if score.cause not in decided and score.testable]
    scores = [score for score in scores if score.gain > settings.MIN_CLASS_SCORE * settings.MIN_GAIN]
    cutoff_gain = selected.gain - settings.OUT_OF_CLASS_GAIN
    # A score estimates a gain by a parabola, which may be wrong by the factor `steepness`.  So the score only sorts out
    # candidates that cannot reach the class even then.
    scores = [
        score
        for score in scores
        if score.gain > settings.COMPARABLE_SCORE * gain
        # Either condition suffices: a similar signature, or a gain that could still reach the class.
        if score.cause in similar or score.gain * steepness(score.cause) > cutoff_gain
    ][: max((1 if search.quick else search.max_candidates) - len(known), 2)]
    trials = [trial for trial in known if trial.cause not in (cause.name, *same)]
    trials += [renamed(criterion, selected, other) for other in same]
    # Candidates far behind the class are not fitted to the end: only the lead in `runner_up` depends on them.
    trials += fit_candidates(criterion, current, scores, cutoff_gain=cutoff_gain)
    # A fit from the model without the cause may end in a worse maximum than one from the fit of the cause itself.
    trials = criterion.each(
        lambda trial: _refit_from(criterion, selected, trial) if trial.cause in similar else trial, trials
    )
    trials = sorted((trial for trial in trials if within_range(trial)), key=lambda trial: -trial.gain)
    if periodic.AMPLITUDE in current.free:
        _rephase(criterion, selected, trials, similar, selection.gains.get(periodic.CAUSE.name, 0.0))
    return sorted(trials, key=lambda trial: -trial.gain)


def _rephase(
    criterion: Criterion, selected: Trial, trials: list[Trial], similar: set[str], periodic_gain: float
) -> None:
    """Fit phases of the periodic force for each candidate of `similar` that those of `selected` may hold back.

    Changes `trials`; `periodic_gain` is the gain of the periodic force.

    A lag of the sensor shifts the phase of a periodic force as it is read, a lag of the field does not.  On two
    simulated flights the log-likelihood of the right cause was 990 below that of the wrong one with the phases of the
    latter, and 110 above it with its own.
    """
    # Only between the two: further behind, phases are not the reason, and further ahead none are needed.
    lower, upper = selected.gain - settings.PHASE_SHARE * periodic_gain, selected.gain + settings.EQUIVALENT_GAIN
    behind = [n for n, trial in enumerate(trials) if trial.cause in similar and lower < trial.gain < upper]
    for n in behind[: settings.PHASE_CANDIDATES] if periodic_gain > 0.0 else ():
        trial = trials[n]
        fit = periodic.refine_phases(
            criterion, periodic.fit_phases(criterion, trial.fit, settings.PASSES), settings.PASSES
        )
        trials[n] = replace(trial, fit=fit, gain=trial.gain + fit.loglik - trial.fit.loglik)


def _refit_from(criterion: Criterion, selected: Trial, confounder: Trial) -> Trial:
    """Fit `confounder` again, from the parameters found with `selected`, if it is behind."""
    # A member of the class needs no better fit: its membership would not change.
    if selected.gain - confounder.gain < settings.EQUIVALENT_GAIN:
        return confounder
    # A part of the samples suffices to choose a start; the fit that follows uses all.
    start = substitute_start(criterion.thinner, selected.fit.theta, BY_NAME[selected.cause], BY_NAME[confounder.cause])
    start = replace(start, phases_s=confounder.fit.theta.phases_s)
    # The size is a guess that a few passes correct: a start need not beat the fit, only the model with neither cause.
    if criterion.value(start) <= confounder.fit.loglik - confounder.gain:
        return confounder
    lead = selected.gain - settings.EQUIVALENT_GAIN - confounder.gain
    fit = climb(criterion, start, confounder.fit.free, goal=confounder.fit.loglik + lead)
    if fit.loglik <= confounder.fit.loglik:
        return confounder
    return replace(confounder, fit=fit, gain=confounder.gain + fit.loglik - confounder.fit.loglik)
