"""Diagnoses of many campaigns at once, on the cores of this machine or on a Dask cluster.

Rule 1: an answer does not depend on where it was computed, nor on how many workers there are: each diagnosis runs as
        one task, in one thread, from its own seed.
Rule 2: each answer is written by its task, and a record of what was asked after it.  What is there is not computed
        again, so a run that was interrupted goes on where it was.
Rule 3: a task whose worker dies goes to another one, three times (Dask's `allowed-failures`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocol.campaign import load
from protocol.errors import Board51Error, ServiceError, UsageError, missing_extra
from protocol.files import writing

if TYPE_CHECKING:
    from distributed import Client

RECORD = "asked.json"  # beside an answer: what was asked, and the answer in short
CONNECT_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """The answer about one campaign in short; the whole is in its folder."""

    campaign: str  # its folder, below the one that was searched
    verdict: str  # of diagnosis.json; "failed" with an `error`
    causes: tuple[str, ...] = ()
    sentence: str = ""
    error: str = ""


def diagnose_all(
    folder: Path | str,
    out: Path | str,
    *,
    scheduler: str | None = None,
    processes: int = 2,
    data: Path | str | None = None,
    progress: Callable[[str], None] = lambda line: None,
    **options: Any,
) -> list[Answer]:
    """Diagnose each campaign below a folder; the answer of FOLDER/a/b is in OUT/a/b.

    Args:
        folder: searched for files campaign.toml.
        out: folder of the answers.  With a scheduler its workers must see both folders under the same names.
        scheduler: address of a Dask scheduler, such as tcp://10.0.0.5:8786; None: this machine alone.
        processes: workers on this machine.
        data: folder of the recordings, if they are not beside their campaigns.
        progress: is called with a line for each campaign.
        options: of `diagnose`.

    Returns:
        The answers in the order of the folders' names.

    Raises:
        UsageError: there is no campaign, or OUT cannot be written.
        ServiceError: the scheduler does not answer.
    """
    root, target = Path(folder).resolve(), Path(out).resolve()
    shared = None if data is None else Path(data)
    if isinstance(model := options.get("model"), str) and Path(model).is_file():
        options["model"] = Path(model).resolve()  # the name of a shipped model stays
    places = {path.parent.relative_to(root).as_posix(): path for path in sorted(root.rglob("campaign.toml"))}
    if not places:
        raise UsageError(f"There is no campaign.toml below {root}", remedy="Give a folder of campaigns")
    keys = {name: _key(path, shared, options) for name, path in places.items()}
    answers = {name: known for name, key in keys.items() if (known := _known(target / name, key)) is not None}
    if answers:
        progress(f"{len(answers)} of {len(places)} are answered already")
    open_names = [name for name in places if name not in answers]
    tasks = [(name, str(places[name]), str(target / name), shared, keys[name], options) for name in open_names]
    with _client(scheduler, min(processes, len(tasks))) if tasks else nullcontext() as client:
        for answer in _completed(client, tasks) if client is not None else ():
            answers[answer.campaign] = answer
            what = answer.error or f"{answer.verdict} {', '.join(answer.causes)}".strip()
            progress(f"[{len(answers)}/{len(places)}] {answer.campaign}: {what}")
    return [answers[name] for name in places]


def _answer(name: str, campaign: str, out: str, data: Path | None, key: str, options: Mapping[str, Any]) -> Answer:
    """Diagnose one campaign and write its answer; runs on a worker."""
    from twin.api.functions import diagnose

    path = Path(out) / RECORD
    path.unlink(missing_ok=True)  # of another question: its answer is overwritten now
    try:
        result = diagnose(campaign, data=data, workers=1, **options)
        result.save(Path(out))
    except Board51Error as error:
        return Answer(campaign=name, verdict="failed", error=str(error))
    answer = Answer(campaign=name, verdict=result.verdict, causes=result.causes, sentence=result.sentence)
    with writing(path):
        path.write_text(json.dumps({"key": key, **asdict(answer)}, indent=1) + "\n", encoding="utf-8")
    return answer


def _key(path: Path, data: Path | None, options: Mapping[str, Any]) -> str:
    """Return what an answer depends on, as a digest: options, version, campaign file and recordings."""
    digest = hashlib.sha256(json.dumps([version("board51"), options], sort_keys=True, default=str).encode())
    files = [path]
    if isinstance(model := options.get("model"), Path):
        files.append(model)
    try:
        campaign = load(path)
        files += [campaign.path_of(recording, data=data) for recording in campaign.recordings]
    except Board51Error:
        pass  # its task says what is wrong
    for file in files:
        digest.update(hashlib.sha256(file.read_bytes() if file.is_file() else b"").digest())
    return digest.hexdigest()


def _known(out: Path, key: str) -> Answer | None:
    """Return the answer in a folder, if the same was asked."""
    try:
        record = json.loads((out / RECORD).read_text(encoding="utf-8"))
        if record.pop("key") == key and (out / "diagnosis.json").is_file():
            return Answer(**record | {"causes": tuple(record["causes"])})
    except (OSError, ValueError, KeyError, TypeError):
        pass  # none, or not whole: it is computed again
    return None


@contextmanager
def _client(scheduler: str | None, processes: int) -> Iterator[Client]:
    try:
        from distributed import Client, LocalCluster
    except ModuleNotFoundError:
        raise missing_extra("cluster", "distributed") from None
    if scheduler is None:
        # Any free port: None is port 8787, and a second cluster would find it taken.
        local = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
        with (
            LocalCluster(n_workers=processes, threads_per_worker=1, silence_logs=50, **local) as cluster,
            Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise ServiceError(
            f"No Dask scheduler answers at {scheduler} ({error})", remedy="Start `dask scheduler`"
        ) from None
    with client:
        yield client


def _completed(client: Client, tasks: Sequence[tuple[Any, ...]]) -> Iterator[Answer]:
    from distributed import as_completed

    futures = {client.submit(_answer, *task, key=f"{task[0]}-{task[4]}", pure=False): task[0] for task in tasks}
    for future in as_completed(futures):
        # Not an exception here: one campaign that kills its workers must not cost the others their answers.
        failure = future.exception()
        name = futures[future]
        yield future.result() if failure is None else Answer(campaign=name, verdict="failed", error=repr(failure))
