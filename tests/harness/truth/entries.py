"""Our entries: programs that get the folder of a case and write an answer into another.

    python -m tests.harness.truth.entries NAME CASE OUT

`diagnose`, `diagnose-quick`: this repository's; `base`: the paper's model at its best, which names nothing; `bic` and
`pysindy`: regressions on its residual.
"""

from __future__ import annotations

import csv
import math
import resource
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.harness.truth.answer import ALL, write_answer
from tests.harness.truth.draw import NAMES, NO_CAUSE, OTHER
from tests.harness.truth.flights import AHEAD, flights
from tests.harness.truth.residual import MEANS, Regression, forward_bic, pysindy, tabulate
from twin.api.functions import diagnose, identify, predict
from twin.model.parameters import Model

ENTRIES = ("diagnose", "diagnose-quick", "base", "bic", "pysindy")
# Of adequate models, so many hid nothing (twin/diagnosis/matrix.md).
ADEQUATE = 0.95
PRIOR = 0.2  # what a regression spreads over all answers: its terms may imitate others
Predicted = Mapping[str, Sequence[tuple[float, float]]]


def diagnosed(case: Path, out: Path, *, quick: bool) -> None:
    """Answer by `board51 diagnose`."""
    result = diagnose(case, quick=quick, workers=1)
    data = result.to_json()
    probabilities = probabilities_of(data)
    listed = [*data["causes"], *data.get("candidates", ())]
    verdict = {"causes-found": "cause", "partly-explained": "cause", "model-adequate": NO_CAUSE}.get(
        result.verdict, OTHER
    )
    names = _known([listed[0]["name"], *listed[0]["indistinguishable_from"]]) if verdict == "cause" and listed else []
    place = _places(case).get(listed[0]["name"], "") if listed else ""
    _write(
        case, out, probabilities, verdict=verdict, place=place, names=names, predicted=_predicted(case, result.extended)
    )


def probabilities_of(diagnosis: Mapping[str, Any]) -> dict[str, float]:
    """Turn a diagnosis.json into probabilities of all answers.

    A cause has its confidence, divided by the number of causes.  Within its class the likelihood decides.  What is left
    belongs to an unknown cause, or is spread over all names if the causes explain everything.
    """
    probabilities = dict.fromkeys(ALL, 0.0)
    listed = [*diagnosis["causes"], *diagnosis.get("candidates", ())]
    for cause in listed:
        members = {item["name"]: item["log_likelihood_lead"] for item in cause["alternatives"] if not item["stated"]}
        weights = {name: math.exp(min(lead, 0.0)) for name, lead in ({cause["name"]: 0.0} | members).items()}
        for name, weight in weights.items():
            share = cause["confidence"] / len(listed) * weight / sum(weights.values())
            probabilities[name if name in probabilities else OTHER] += share
    verdict = diagnosis["verdict"]
    if verdict == "model-adequate":
        probabilities[NO_CAUSE] = ADEQUATE
    left = 1.0 - math.fsum(probabilities.values())
    if verdict in ("model-adequate", "causes-found"):
        return {name: p + left / len(ALL) for name, p in probabilities.items()}
    return probabilities | {OTHER: probabilities[OTHER] + left}


def base(case: Path, out: Path) -> None:
    """Answer that nothing is hidden, as sure as a guess; predict by the paper's model at its best."""
    probabilities = dict.fromkeys(ALL, 1.0)
    predicted = _predicted(case, identify(case).model)
    _write(case, out, probabilities, verdict=NO_CAUSE, place="", names=[], predicted=predicted)


def regressed(case: Path, out: Path, *, pick: str) -> None:
    """Answer by a regression on the residual of the paper's model at its best."""
    model = identify(case).model
    fit, judge = (tabulate(case, model, use) for use in ("fit", "judge"))
    regression = forward_bic(fit, judge) if pick == "bic" else pysindy(fit, judge)
    predicted: dict[str, list[tuple[float, float]]] = {
        name: list(pairs) for name, pairs in _predicted(case, model).items()
    }
    corrected = judge.x_hat - regression.correction * fit.residuals[:, 0].std()
    for (recording, t), x in zip(judge.keys, corrected.tolist(), strict=True):
        predicted[recording].append((t, x))  # the last row of a time counts
    probabilities = spread(regression)
    best = max(probabilities, key=lambda name: probabilities[name])
    verdict = best if best in (NO_CAUSE, OTHER) else "cause"
    names = [best] if verdict == "cause" else []
    _write(
        case, out, probabilities, verdict=verdict, place=_places(case).get(best, ""), names=names, predicted=predicted
    )


def spread(regression: Regression) -> dict[str, float]:
    """Probabilities in proportion to the weights of the terms, beside `PRIOR` for all answers."""
    total = math.fsum(weight for _, _, weight in regression.terms)
    probabilities = dict.fromkeys(ALL, PRIOR / len(ALL))
    for residual, term, weight in regression.terms:
        probabilities[MEANS.get((residual, term), OTHER)] += (1.0 - PRIOR) * weight / total
    if not regression.terms:
        probabilities[NO_CAUSE] += 1.0 - PRIOR
    return probabilities


def _predicted(case: Path, model: Model) -> Predicted:
    results = [predict(model, case / r.name, horizon_samples=AHEAD, campaign=case) for r, _ in flights(case, "judge")]
    return {r.recording: list(zip(r.t_s.tolist(), r.x_hat_m.tolist(), strict=True)) for r in results}


def _places(case: Path) -> dict[str, str]:
    with (case / "names.csv").open(encoding="utf-8", newline="") as file:
        return {row["name"]: row["place"] for row in csv.DictReader(file)}


def _known(names: Sequence[str]) -> list[str]:
    """Names of the list; ours also has causes that cannot be hidden here."""
    return [name for name in dict.fromkeys(names) if name in NAMES] or [OTHER]


def _write(case: Path, out: Path, probabilities: Mapping[str, float], **answer: Any) -> None:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = round(time.process_time() + children.ru_utime + children.ru_stime, 2)
    write_answer(out, probabilities, seconds=seconds, **answer)


def main(name: str, case: Path, out: Path) -> None:
    """Answer one case."""
    if name in ("diagnose", "diagnose-quick"):
        diagnosed(case, out, quick=name.endswith("quick"))
    elif name == "base":
        base(case, out)
    else:
        regressed(case, out, pick=name)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))
