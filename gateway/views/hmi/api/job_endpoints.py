"""The endpoints of longer work: campaigns, recordings, identification, and the other jobs of forms.py."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import Any

from starlette.responses import FileResponse, Response

from gateway.views.dispatch import Wish
from gateway.views.hmi import snapshot
from gateway.views.hmi.actions import Actions, Order
from gateway.views.hmi.acts import Acts
from gateway.views.hmi.api import shapes
from gateway.views.hmi.api.base import ACT, RIG, Base
from gateway.views.hmi.api.forms import JOBS, Design, Identify, ResultQuery, StartCampaign, StartRecording, StopJob
from gateway.views.hmi.api.resource import JSON, BodyKinds, Call, Endpoint
from gateway.views.hmi.api.rigs import Table
from gateway.views.hmi.gains import parse_gains
from gateway.views.hmi.jobs import Job
from gateway.views.hmi.model.campaigns import MODEL, RESULT_FILES, RESULTS, CampaignFolder
from gateway.views.hmi.model.designs import newest_design
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.refusals import RefusalError
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.starts import STARTS
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError

_JOB = BodyKinds("job", JOBS)


class WorkEndpoints(Base):
    """The endpoints of work on models, and of recordings."""

    def __init__(self, actions: Actions, acts: Acts, work: ModelWork) -> None:
        super().__init__(actions, acts)
        self._work = work

    def table(self) -> list[Endpoint]:
        """Return these endpoints."""
        e, get, post = Endpoint, "GET", "POST"
        return [
            e(get, "/rigs/{rig}/campaigns", self.campaigns, shapes.Campaigns, "campaigns", statuses=RIG),
            e(post, "/rigs/{rig}/campaigns", self.start_campaign, shapes.Reply, "campaigns",
              body=StartCampaign, statuses=ACT),
            e(post, "/rigs/{rig}/campaigns/interrupt", self.interrupt, shapes.Reply, "campaigns", statuses=ACT),
            e(get, "/rigs/{rig}/models", self.models, shapes.Models, "models", statuses=RIG),
            e(post, "/rigs/{rig}/models", self.identify, shapes.Reply, "models", body=Identify, statuses=ACT),
            e(get, "/rigs/{rig}/models/{model}", self.model, dict[str, Any], "models",
              statuses={404: "no rig or model of this name"}),
            e(post, "/rigs/{rig}/recordings", self.start_recording, shapes.Reply, "logs",
              body=StartRecording, statuses=ACT),
            e(post, "/rigs/{rig}/recordings/stop", self.stop_recording, shapes.Reply, "logs", statuses=ACT),
            e(get, "/rigs/{rig}/jobs", self.jobs, shapes.Jobs, "jobs", statuses=RIG),
            e(post, "/rigs/{rig}/jobs", self.start_job, shapes.Reply, "jobs", body=_JOB, statuses=ACT),
            e(post, "/rigs/{rig}/jobs/stop", self.stop_job, shapes.Reply, "jobs", body=StopJob, statuses=ACT),
            e(get, "/rigs/{rig}/results/{result}", self.result, dict[str, Any], "jobs",
              query=ResultQuery, statuses={404: "no rig, campaign or result of this name"}),
        ]  # fmt: skip

    async def campaigns(self, call: Call) -> Table:
        """List the campaigns of a rig, and the progress of the one that runs."""
        board = self._board(call).name
        folders = await asyncio.to_thread(self._work.campaigns, board)
        listed = [
            {
                **snapshot.fields(folder, "name", "recordings", "interrupted"),
                "left": list(folder.left),
                "has_model": folder.file(MODEL) is not None,
                "has_diagnosis": folder.file(RESULT_FILES["diagnosis"]) is not None,
            }
            for folder in folders
        ]
        return {"work": self._latest("campaign", board), "campaigns": listed}

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

    async def models(self, call: Call) -> Table:
        """List the models of a rig, and the progress of an identification that runs."""
        board = self._board(call).name
        files = await asyncio.to_thread(self._work.models, board)
        entries = [snapshot.fields(file, "name", "kind", "made", "summary", "in_use") for file in files]
        return {"work": self._latest("identify", board), "models": entries}

    async def identify(self, call: Call) -> Response:
        """Identify K_A, T_A, K_c and b from a campaign; GET returns the progress and lists the model."""
        return await self._start(call, "identify", {"campaign": call.body.campaign})

    async def model(self, call: Call) -> Response:
        """Return a model file, as `board51 identify` writes it."""
        board = self._board(call).name
        file = await asyncio.to_thread(self._work.model, board, call.path("model"))
        return FileResponse(file.path, media_type=JSON, filename=f"{board}-{file.path.name}")

    async def start_recording(self, call: Call) -> Response:
        """Start a recording: a file of its own, which appears among the logs."""
        return await self._start(call, "record", {"title": call.body.title})

    async def stop_recording(self, call: Call) -> Response:
        """Stop the recording that runs, and close its file."""
        return await self._end(call, "record")

    async def jobs(self, call: Call) -> Table:
        """List the latest job of each kind of a rig, with its progress."""
        return {"jobs": [_progress(job) for job in self._actions.jobs.of(self._board(call).name)]}

    async def start_job(self, call: Call) -> Response:
        """Start work on campaigns and models; GET returns its progress, and results has the result."""
        table = asdict(call.body)
        if isinstance(call.body, Design):  # starts.py reads the units of the page's form
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
            raise RefusalError(
                "no-result", f"There is no result {name[:40]!r}", status=404, remedy=f"Take {', '.join(RESULTS)}"
            )
        campaign = await asyncio.to_thread(self._work.campaign, board, call.query.campaign)
        if campaign is None:
            raise RefusalError("no-campaign", text_of("refusal.no_campaign"), status=404)
        result = await asyncio.to_thread(_result_of, name, campaign, self._work.feed.latest(board, pb.Parameters))
        if not result:
            raise RefusalError("no-result", f"{campaign.name} has no {name}", status=404)
        return result

    def _latest(self, kind: str, board: str) -> Table | None:
        job = self._actions.jobs.get(kind, board)
        return None if job is None else _progress(job)

    async def _start(self, call: Call, kind: str, table: dict[str, object]) -> Response:
        board = self._board(call).name

        def do(session: LoginSession, _wish: Wish) -> pb.CommandReply:
            return STARTS[kind](self._work, Order(session=session, kind=kind, board=board, table=table))

        return await self._act(call, do)

    async def _end(self, call: Call, kind: str) -> Response:
        board = self._board(call).name
        return await self._act(call, lambda session, _: self._actions.stop_job(session, kind, board), board="")


def _progress(job: Job) -> Table:
    return {"kind": job.kind, **snapshot.job(job)}


def _result_of(name: str, campaign: CampaignFolder, parameters: pb.Parameters | None) -> dict[str, Any]:
    """Return one of RESULTS of a campaign, of designs the newest; empty if there is none.

    The gains of a design must fit to the parameters of the board.
    """
    if name in RESULT_FILES:
        return campaign.result(name)
    design = newest_design(campaign)
    if design is None or name == "forecast":
        return {} if design is None else design.forecast
    if not design.analysis:
        return {}
    command, problem = None, ""
    try:
        gains = parse_gains(design.controller.read_bytes(), parameters)
        point = {name: getattr(gains, name) for name in ("i_0_a", "x_0_m", "u_0_v")}
        law = "pid" if gains.law == pb.LAW_PID else "lqi"
        command = {"command": "gains", "law": law, "gains": list(gains.gains), **point}
    except (DataError, OSError) as error:
        problem = str(error)
    return {"command": command, "problem": problem, "is_loaded": design.is_on(parameters), **design.analysis}
