"""An answer to "name the cause": six keys in answer.json, and the predictions beside it.

{"verdict": "cause",                                  cause | nothing | other
 "probabilities": {"core-saturation": 0.9, "other": 0.1},    of names.csv, `nothing` and `other`; 0 if absent
 "place": "force",                                    force | current | position | input | time; "" for nothing
 "class": ["core-saturation", "force-exponent"],      names that the data do not separate
 "predictions": "predictions.csv",                    recording,t_s,x_m: x 20 ms ahead on the judge recordings
 "seconds": 12.5}                                     of processor time
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from protocol.checked import Keys, Number, RuleError, checked, key
from protocol.errors import DataError, quoted
from tests.harness.truth.draw import NAMES, NO_CAUSE, OTHER
from tests.harness.truth.flights import stamp

ALL = (*NAMES, NO_CAUSE, OTHER)
SUM_ERROR = 0.01
COLUMNS = ["recording", "t_s", "x_m"]


def _of_the_list(names: Sequence[str]) -> Sequence[str]:
    for name in names:
        if name not in ALL:
            raise RuleError(f" has {quoted(name)}", remedy="Take names of names.csv, nothing or other")
    return names


def _a_whole(probabilities: dict[str, float]) -> dict[str, float]:
    _of_the_list(list(probabilities))
    total = math.fsum(probabilities.values())
    if abs(total - 1.0) > SUM_ERROR:
        raise RuleError(f" sum to {total:.4g}", remedy="Give probabilities that sum to 1")
    return probabilities


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer(Keys):
    """The content of answer.json."""

    verdict: Literal["cause", "nothing", "other"]
    probabilities: Annotated[dict[str, Annotated[Number, key("probability", 0.0, 1.0)]], AfterValidator(_a_whole)]
    place: Literal["force", "current", "position", "input", "time", ""]
    names: Annotated[tuple[str, ...], Field(alias="class"), AfterValidator(_of_the_list)]
    predictions: Annotated[str, Field(min_length=1)]
    seconds: Annotated[Number, key("processor time, s", 0.0)]


def read_answer(folder: Path) -> tuple[Answer, dict[tuple[str, int], float]]:
    """Read an answer and its predictions, x in m by (recording, `stamp` of its time).

    Raises:
        DataError: a file is absent, a key or a value is wrong; the message names file, key and what to write.
    """
    file = folder / "answer.json"
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        raise DataError(
            f"{file}: {problem}", remedy="Write answer.json into the folder of the second argument"
        ) from None
    answer: Answer = checked(Answer, data, where=str(file), error=DataError)
    return answer, _read_predictions(folder / answer.predictions)


def write_answer(
    folder: Path,
    probabilities: Mapping[str, float],
    *,
    verdict: str,
    place: str,
    names: Sequence[str],
    predicted: Mapping[str, Sequence[tuple[float, float]]],
    seconds: float,
) -> None:
    """Write answer.json and predictions.csv, rows (t in s, x in m) by recording; probabilities are normalised."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "predictions.csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        for recording, pairs in predicted.items():
            rows.writerows((recording, f"{t:.7g}", f"{x:.9g}") for t, x in pairs)
    total = math.fsum(probabilities.values())
    answer = {
        "verdict": verdict,
        "probabilities": {name: p / total for name, p in probabilities.items() if p > 0.0},
        "place": place,
        "class": list(names),
        "predictions": "predictions.csv",
        "seconds": seconds,
    }
    (folder / "answer.json").write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")


def _read_predictions(file: Path) -> dict[tuple[str, int], float]:
    predicted = {}
    try:
        with file.open(encoding="utf-8", newline="") as text:
            rows = csv.reader(text)
            if next(rows, []) != COLUMNS:
                raise DataError(f"{file}:1 is not the header", remedy=f"Write {','.join(COLUMNS)}")
            for line, row in enumerate(rows, 2):
                try:
                    recording, t, x = row[0], float(row[1]), float(row[2])
                except (ValueError, IndexError):
                    raise DataError(f"{file}:{line} is {row}", remedy="Write recording, time in s, x in m") from None
                if not (math.isfinite(t) and math.isfinite(x)):
                    raise DataError(f"{file}:{line} is not finite", remedy="Leave out rows without a prediction")
                predicted[recording, stamp(t)] = x
    except OSError as problem:
        raise DataError(f"{file}: {problem.strerror}", remedy="Write the file that `predictions` names") from None
    return predicted
