"""The endpoints of longer work: campaigns, recordings, identification, and the jobs of job_bodies.py."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import Any

from starlette.responses import FileResponse, Response

from gateway.views.hmi import snapshot
from gateway.views.hmi.actions import Actions
from gateway.views.hmi.acts import Acts
from gateway.views.hmi.api import job_bodies, shapes
from gateway.views.hmi.api.base import ACT, RIG, Base, body_of, body_of_one
from gateway.views.hmi.api.queries import Identify, ResultQuery, StartCampaign, StartRecording
from gateway.views.hmi.api.resource import JSON, Call, Endpoint, ProblemError
from gateway.views.hmi.api.results import RESULTS, result_of
from gateway.views.hmi.jobs import Job
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.starts import starts
from gateway.views.hmi.texts import text_of

_JOB = body_of_one("job", job_bodies.KINDS)


class WorkEndpoints(Base):
    """The endpoints of work on models, and of recordings.

    Args:
        actions: checks rights, and acts.
        acts: runs acts.
        work: on models.
    """

    def __init__(self, actions: Actions, acts: Acts, work: ModelWork) -> None:
        super().__init__(actions, acts)
        self._work, self._starts = work, starts(actions, work)

    def table(self) -> list[Endpoint]:
        """Return these endpoints."""
        e, get, post = Endpoint, "GET", "POST"
        return [
            e(method=get, path="/rigs/{rig}/campaigns", run=self.campaigns, answer=shapes.Campaigns, tag="campaigns",
              statuses=RIG),
            e(method=post, path="/rigs/{rig}/campaigns", run=self.start_campaign, answer=shapes.Reply,
              tag="campaigns", body=body_of(StartCampaign), body_type=StartCampaign, statuses=ACT),
            e(method=post, path="/rigs/{rig}/campaigns/interrupt", run=self.interrupt, answer=shapes.Reply,
              tag="campaigns", statuses=ACT),
            e(method=get, path="/rigs/{rig}/models", run=self.models, answer=shapes.Models, tag="models",
              statuses=RIG),
            e(method=post, path="/rigs/{rig}/models", run=self.identify, answer=shapes.Reply, tag="models",
              body=body_of(Identify), body_type=Identify, statuses=ACT),
            e(method=get, path="/rigs/{rig}/models/{model}", run=self.model, answer=dict[str, Any], tag="models",
              statuses={404: "no rig or model of this name"}),
            e(method=post, path="/rigs/{rig}/recordings", run=self.start_recording, answer=shapes.Reply, tag="logs",
              body=body_of(StartRecording), body_type=StartRecording, statuses=ACT),
            e(method=post, path="/rigs/{rig}/recordings/stop", run=self.stop_recording, answer=shapes.Reply,
              tag="logs", statuses=ACT),
            e(method=get, path="/rigs/{rig}/jobs", run=self.jobs, answer=shapes.Jobs, tag="jobs", statuses=RIG),
            e(method=post, path="/rigs/{rig}/jobs", run=self.start_job, answer=shapes.Reply, tag="jobs",
              body=_JOB, body_type=job_bodies.Body, statuses=ACT),
            e(method=post, path="/rigs/{rig}/jobs/stop", run=self.stop_job, answer=shapes.Reply, tag="jobs",
              body=body_of(job_bodies.StopJob), body_type=job_bodies.StopJob, statuses=ACT),
            e(method=get, path="/rigs/{rig}/results/{result}", run=self.result, answer=dict[str, Any], tag="jobs",
              query=ResultQuery, statuses={404: "no rig, campaign or result of this name"}),
        ]  # fmt: skip

    async def campaigns(self, call: Call) -> shapes.Campaigns:
        """List the campaigns of a rig, and the progress of the one that runs."""
        board = self._board(call).name
        folders = await asyncio.to_thread(self._work.campaigns, board)
        return shapes.Campaigns(
            work=self._latest("campaign", board),
            campaigns=[
                shapes.Campaign(
                    name=folder.name,
                    recordings=folder.recordings,
                    interrupted=folder.interrupted,
                    left=list(folder.left),
                    has_model=folder.model is not None,
                    has_diagnosis=folder.diagnosis is not None,
                )
                for folder in folders
            ],
        )

    async def start_campaign(self, call: Call) -> Response:
        """Start a campaign, which moves the ball; GET returns its progress."""
        body: StartCampaign = call.body
        table: dict[str, object] = {"quick": body.quick, "investigate": body.investigate}
        if body.resume:
            table = {"resume": True, "campaign": body.resume}
        return await self._start(call, "campaign", table)

    async def interrupt(self, call: Call) -> Response:
        """Interrupt the campaign that runs; it parks the ball."""
        return await self._end(call, "campaign")

    async def models(self, call: Call) -> shapes.Models:
        """List the models of a rig, and the progress of an identification that runs."""
        board = self._board(call).name
        files = await asyncio.to_thread(self._work.models, board)
        entries = [
            shapes.ModelEntry(name=f.name, kind=f.kind, made=f.made, summary=f.summary, in_use=f.in_use) for f in files
        ]
        return shapes.Models(work=self._latest("identify", board), models=entries)

    async def identify(self, call: Call) -> Response:
        """Identify K_A, T_A, K_c and b from a campaign; GET returns the progress and lists the model."""
        return await self._start(call, "identify", {"campaign": call.body.campaign})

    async def model(self, call: Call) -> Response:
        """Return a model file, as `board51 identify` writes it."""
        board = self._board(call).name
        files = await asyncio.to_thread(self._work.models, board)
        for file in files:
            if file.name == call.path("model"):
                return FileResponse(file.path, media_type=JSON, filename=f"{board}-{file.path.name}")
        raise ProblemError(404, "no-model", text_of("refusal.no_model"))

    async def start_recording(self, call: Call) -> Response:
        """Start a recording: a file of its own, which appears among the logs."""
        return await self._start(call, "record", {"title": call.body.title})

    async def stop_recording(self, call: Call) -> Response:
        """Stop the recording that runs, and close its file."""
        return await self._end(call, "record")

    async def jobs(self, call: Call) -> shapes.Jobs:
        """List the latest job of each kind of a rig, with its progress."""
        return shapes.Jobs(jobs=[_progress(job) for job in self._actions.jobs.of(self._board(call).name)])

    async def start_job(self, call: Call) -> Response:
        """Start work on campaigns and models; GET returns its progress, and results has the result."""
        table = asdict(call.body)
        if isinstance(call.body, job_bodies.Design):  # starts.py reads the units of the page's form
            wish = call.body
            table |= {"x_mm": 1e3 * wish.x_m, "settling_ms": 1e3 * wish.settling_s if wish.settling_s else None}
        return await self._start(call, call.body.job, table)

    async def stop_job(self, call: Call) -> Response:
        """Interrupt a job that runs."""
        return await self._end(call, call.body.job)

    async def result(self, call: Call) -> dict[str, Any]:
        """Return the latest result of a campaign as its `board51` command writes it; of design with its command gains.

        One of validation, diagnosis, comparison, bode, design, forecast.
        """
        board, name = self._board(call).name, call.path("result")
        if name not in RESULTS:
            raise ProblemError(
                404, "no-result", f"There is no result {name[:40]!r}", remedy=f"Take {', '.join(RESULTS)}"
            )
        campaign = await asyncio.to_thread(self._work.campaign, board, call.query.campaign)
        if campaign is None:
            raise ProblemError(404, "no-campaign", text_of("refusal.no_campaign"))
        result = await asyncio.to_thread(result_of, name, campaign, self._work.parameters(board))
        if not result:
            raise ProblemError(404, "no-result", f"{campaign.name} has no {name}")
        return result

    def _latest(self, kind: str, board: str) -> shapes.Work | None:
        job = self._actions.jobs.get(kind, board)
        return None if job is None else _progress(job)

    async def _start(self, call: Call, kind: str, table: dict[str, object]) -> Response:
        board = self._board(call).name
        return await self._act(call, lambda session, _: self._starts[kind](session, board, table))

    async def _end(self, call: Call, kind: str) -> Response:
        board = self._board(call).name
        return await self._act(call, lambda session, _: self._actions.stop_job(session, kind, board), board="")


def _progress(job: Job) -> shapes.Work:
    return shapes.Work(kind=job.kind, **snapshot.job(job))
