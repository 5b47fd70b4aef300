"""The choice of experiments for a run: by name or the default ones, and their shorter form for `--quick`.  Pure."""

from __future__ import annotations

from dataclasses import replace

from protocol.experiments import MENU, Burst, Expectation, Experiment, Hover, Step, Wave


def shortened(experiment: Experiment) -> Experiment:
    """The experiment for `--quick`: shorter, or with every other amplifier step."""
    keep = experiment.quick
    if not 0.0 < keep < 1.0:
        return replace(experiment, steps=experiment.steps[::2]) if experiment.name == "amplifier-steps" else experiment
    return replace(experiment, steps=tuple(_shortened(step, keep, experiment.expects) for step in experiment.steps))


def _shortened(step: Step, keep: float, expects: Expectation) -> Step:
    match step:
        case Burst():
            return step
        case Wave() if expects == "lifts-off":  # as many ramps, each shorter
            return replace(step, period_s=step.period_s * keep, duration_s=step.duration_s * keep)
        case Hover(duration_s=duration_s) if duration_s < 1.0:
            return step
        case _:
            return replace(step, duration_s=step.duration_s * keep)


def chosen(names: tuple[str, ...] = (), *, quick: bool = False) -> tuple[Experiment, ...]:
    """The experiments of a run, in the order of the menu; the default ones without names."""
    listed = [e for e in MENU if (e.name in names if names else e.standard and (e.quick > 0.0 or not quick))]
    return tuple(shortened(e) if quick else e for e in listed)
