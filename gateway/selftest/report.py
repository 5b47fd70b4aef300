"""The report of a self-test: its answer, JSON for programs, HTML for people."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path

from gateway.selftest.verdict import Result, Verdict
from protocol.errors import UsageError

_TEMPLATE = "report.html"
_CUT = "CUT THE SUPPLY"
# Checks that find the cause of a fault that an earlier check reported.
_CAUSES = ("unexpected-reset", "current-sensor", "stuck-bit-i-c", "time-constant", "position-polarity")


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """The verdicts of one run."""

    verdicts: Sequence[Verdict]
    rig: str
    port: str
    started_s: float  # Unix time
    duration_s: float

    @property
    def faults(self) -> int:
        """The number of faults."""
        return len(self._of(Result.FAULT))

    @property
    def answer(self) -> str:
        """The answer in two sentences at most: the first fault and what to do, as the others often follow from it."""
        faults, warnings = self._of(Result.FAULT), self._of(Result.WARNING)
        if not faults:
            ok, skipped = len(self._of(Result.OK)), len(self._of(Result.SKIPPED))
            counted = f"{ok} ok, {len(warnings)} warning{'s' * (len(warnings) != 1)}, {skipped} skipped"
            return f"No fault: {counted}."
        first = cause_of(faults)
        unsafe = next((verdict for verdict in faults if _CUT in verdict.remedy), None)
        count = "One fault" if len(faults) == 1 else f"{len(faults)} faults; repair first"
        remedy = (unsafe or first).remedy
        return f"{count} ({first.check}): {first.what} {first.value}. {remedy[:1].upper()}{remedy[1:]}."

    def _of(self, result: Result) -> list[Verdict]:
        return [verdict for verdict in self.verdicts if verdict.result == result]


def cause_of(faults: Sequence[Verdict]) -> Verdict:
    """Return the fault to mend first: the first one, unless a later check finds its cause."""
    return next((verdict for name in _CAUSES for verdict in faults if verdict.name == name), faults[0])


def write_report(report: Report, folder: Path) -> list[Path]:
    """Write JSON, and HTML if jinja2 is installed (extra `web`); return the files.

    Raises:
        UsageError: the folder cannot be written.
    """
    stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(report.started_s))
    content = {"answer": report.answer, "faults": report.faults, **asdict(report)}
    contents = {"json": json.dumps(content, indent=1, ensure_ascii=False) + "\n"}
    page = _html(report)
    if page is not None:
        contents["html"] = page
    try:
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / f"selftest-{stamp}.{ending}" for ending in contents]
        for path, text in zip(paths, contents.values(), strict=True):
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        problem = f"{folder} cannot be written ({error.strerror})"
        raise UsageError(problem, remedy="Give another --log-dir; the verdicts are above") from None
    return paths


def _html(report: Report) -> str | None:
    """Return the page; None without jinja2, as the verdicts were printed, too."""
    try:
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ModuleNotFoundError:
        return None
    templates = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    groups = [(name, list(verdicts)) for name, verdicts in groupby(report.verdicts, lambda verdict: verdict.check)]
    counts = {result.value: sum(v.result == result for v in report.verdicts) for result in Result}
    when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(report.started_s))
    return templates.get_template(_TEMPLATE).render(report=report, groups=groups, counts=counts, when=when) + "\n"
