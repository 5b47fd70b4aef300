"""Compile the numerical kernels now, so that no later command waits for it.

The first identify, validate, what-if, diagnose or twin after an installation or an update compiles what it needs, which
takes up to a minute.  This command compiles everything at once: it simulates a short campaign of the nominal CE 152 and
runs each of them on it.  `make setup` calls it.  A second run takes a few seconds.
"""

from __future__ import annotations

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from twin.commands import progress_printer
from twin.model.parameters import Model


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "example:\n  board51 compile    after pipx install, or an update\n"
        "\nexit code 0: done, or no folder for compiled code is writable, so each command compiles again"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress on stderr")


def run(args: argparse.Namespace) -> int:
    """Compile."""
    from protocol.campaign import Campaign
    from twin import compiled
    from twin.api import functions as api
    from twin.mirror.warm_up import compile_kernels
    from twin.validation.source import source_at
    from twin.what_if.forecast import forecast

    print_progress = progress_printer(quiet=args.quiet)
    if not compiled.cache_folder():
        print_progress("board51 compile: no folder for compiled code can be written; set NUMBA_CACHE_DIR to one")
        return 0
    model = Model.load("ce152")
    # A compiler runs on one core: the twin's is another process.  What both need, both compile.
    other = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
    with tempfile.TemporaryDirectory() as folder, other:
        print_progress("the twin, and at the same time a simulated short campaign")
        twin = other.submit(compile_kernels, model)
        campaign = _campaign(Path(folder), model)
        print_progress("identify, validate, predict")
        api.identify(campaign)
        api.validate(campaign, model)
        api.predict(model, Path(folder) / "judge.csv", campaign=campaign)
        print_progress("what-if")
        flight = source_at(Path(folder) / "judge.csv", model, Campaign.load(campaign))
        assert flight.law is not None
        forecast(flight, model, flight.law, draws=2)
        print_progress("diagnose")
        api.diagnose(campaign, quick=True, free_form=True, experiments=True)
        print_progress("design")
        api.design(model)
        twin.result()
    print_progress("compiled")
    return 0


def _campaign(folder: Path, model: Model) -> Path:
    """A folder with flights, a step of the amplifier and the ball at rest."""
    import numpy as np

    from protocol.campaign import Campaign, Recording, Use
    from protocol.campaign_text import emit
    from twin.diagnosis.experiments.closed_loop import TICK_S, Rig
    from twin.diagnosis.experiments.designed_law import designed
    from twin.diagnosis.experiments.virtual_recordings import Schedule, simulate
    from twin.inference.theta import Theta
    from twin.model.causes.catalogue import CATALOGUE

    hidden = next(cause for cause in CATALOGUE if cause.family == "motion")  # something to find
    theta = Theta(
        K_A=model.K_A,
        T_A=model.T_A,
        K_c=model.K_c,
        b=model.b,
        sigma_i_c_a=1e-3,
        sigma_x_m=3e-6,
        process_i_c_a=1e-6,
        process_a_m_s2=1e-3,
        causes=((f"{hidden.name}.{hidden.strength.name}", hidden.strength.probes[-1]),),
    )
    middle = 0.5 * model.plant.travel_m
    t = TICK_S * np.arange(3000)
    steps = middle + 0.2 * middle * np.sign(np.sin(5.0 * t))
    schedules = [
        Schedule(name="fit.csv", kind="closed-loop", command=steps, closed_loop=True),
        Schedule(name="judge.csv", kind="closed-loop", command=steps[::-1].copy(), closed_loop=True),
        Schedule(name="rest.csv", kind="free", command=np.zeros(1000)),
        Schedule(name="amplifier.csv", kind="amplifier-step", command=np.repeat((0.5, 1.5), 500)),
    ]
    recordings = []
    for seed, schedule in enumerate(schedules):
        (record,) = simulate(Rig(theta=theta, plant=model.plant), schedule, seed=seed)
        columns = {"t": record.t, "u_c": record.u_c, "i_c": record.i_c, "x": record.x, "x_ref": record.x_ref}
        known = {name: values for name, values in columns.items() if np.isfinite(values).any()}
        table, header = np.column_stack(list(known.values())), ",".join(known)
        np.savetxt(folder / schedule.name, table, delimiter=",", header=header, comments="")
        use: Use = "judge" if schedule.name == "judge.csv" else "fit"
        recordings.append(Recording(file=schedule.name, kind=schedule.kind, use=use))
    campaign = Campaign(
        where=str(folder / "campaign.toml"),
        folder=folder,
        plant=model.plant,
        controller=designed(theta, model.plant, TICK_S),
        recordings=tuple(recordings),
    )
    (folder / "campaign.toml").write_text(emit(campaign), encoding="utf-8")
    return folder
