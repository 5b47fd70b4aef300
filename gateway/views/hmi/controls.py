"""The controls of a rig's page.  Each is a card; what may not be used is not there.

Rule: a control says what became of it, in the words of whoever decided: page, gateway, board or link.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from nicegui import events, ui

from gateway.views.hmi.console import Console
from gateway.views.hmi.gains import MAX_BYTES, parse_gains, rows
from gateway.views.hmi.guard import TOKEN_HEADER
from gateway.views.hmi.sessions import Session
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError

_MODES = (("Idle", "idle", pb.MODE_IDLE), ("Open loop", "open loop", pb.MODE_OPEN_LOOP),
          ("Closed loop", "closed loop", pb.MODE_CLOSED_LOOP))  # fmt: skip
_SHAPES = {pb.SHAPE_STEP: "step", pb.SHAPE_RECTANGLE: "rectangle", pb.SHAPE_SAWTOOTH: "sawtooth", pb.SHAPE_PRBS: "prbs",
           pb.SHAPE_MULTISINE: "multisine", pb.SHAPE_CHIRP: "chirp"}  # fmt: skip
_FOLLOW_S = 0.5  # how often controls look at what others did
_LINES_SHOWN = 12
_GAPS = re.compile(r"\s{2,}")
COUNT_M = 5e-7  # the board's reference is in counts of its converter: smaller differences are rounding


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Whose page of which board."""

    console: Console
    session: Session
    board: str

    async def send(self, what: pb.Command) -> pb.CommandReply:
        """A command, and what became of it on the screen."""
        reply = await asyncio.to_thread(self.console.command, self.session, self.board, what)
        tell(reply)
        return reply

    def parameters(self) -> pb.Parameters | None:
        """Of the board, if it has said."""
        board = self.console.feed.board(self.board)
        return None if board is None else board.latest(pb.Parameters)


def tell(reply: pb.CommandReply) -> None:
    """What became of it, in words; a refusal stays until it is closed."""
    if reply.accepted:
        ui.notify(f"\u2713 {reply.text or 'accepted'}", type="positive", position="bottom-left", timeout=2500)
        return
    by = f"Refused by {reply.refused_by} ({reply.reason}): " if reply.refused_by else ""
    ui.notify(f"\u2715 {by}{reply.text}", type="negative", position="bottom-left", timeout=8000, close_button="Close",
              multi_line=True)  # fmt: skip


def act(text: str, do: Callable[[], pb.CommandReply], *, then: str = "") -> ui.button:
    """A button whose work is done in a thread; `then` is the page to go to where it was accepted."""

    async def clicked() -> None:
        reply = await asyncio.to_thread(do)
        tell(reply)
        if reply.accepted and then:
            ui.navigate.to(then)

    return ui.button(text, on_click=clicked).props("outline dense no-caps")


def _card(title: str) -> ui.element:
    section = ui.element("section").classes("card")
    with section:
        ui.label(title).classes("card-title")
    return section


def steering(place: Place) -> None:
    """Mode, reference, excitation."""
    if not place.console.may(place.session, "set_reference"):
        return
    with _card("Mode"), ui.element("div").classes("modes"):
        for text, word, mode in _MODES:
            with ui.element("button").classes("mode").props(f'type="button" data-mode="{word}"') as button:
                ui.label(text)
            button.on("click", _mode(place, mode))
    with _card("Reference"):
        _reference(place)
    with _card("Excitation"):
        _excitation(place)


def _mode(place: Place, mode: pb.Mode) -> Callable[[], Awaitable[pb.CommandReply]]:
    return lambda: place.send(pb.Command(set_mode=pb.SetMode(mode=mode)))


def _reference(place: Place) -> None:
    async def send(value_mm: float | None) -> None:
        if value_mm is None:
            tell(pb.CommandReply(text="Give the reference as a number of millimetres."))
            return
        await place.send(pb.Command(set_reference=pb.SetReference(x_ref_m=float(value_mm) * 1e-3)))

    with ui.element("div").classes("reference"):
        slider = ui.slider(min=0.0, max=6.0, step=0.01, value=0.0).props(
            'label data-slider="reference" aria-label="Reference in mm"'
        )
        with ui.element("div").classes("row-of"):
            number = ui.number("mm", min=0.0, step=0.1, format="%.3f").props('dense outlined data-number="reference"')
            ui.button("Set", on_click=lambda: send(number.value)).props("unelevated no-caps")
            ends = ui.label("").classes("hint")
    slider.on("change", lambda: send(slider.value))  # when the handle is let go, not on its way
    number.on("keydown.enter", lambda: send(number.value))
    followed = [float("nan")]
    busy: set[str] = set()  # what a hand is on: it must not be moved away under it
    number.on("focus", lambda: busy.add("number"))
    number.on("blur", lambda: busy.discard("number"))
    slider.on("pan", lambda event: (busy.add if event.args == "start" else busy.discard)("slider"))

    def follow() -> None:
        """Show the limits of the board, and a reference that somebody else has set."""
        board = place.console.feed.board(place.board)
        parameters = place.parameters()
        state = board.latest(pb.State) if board is not None else None
        if parameters is not None and parameters.x_ref_max_m > parameters.x_ref_min_m:
            low, high = round(parameters.x_ref_min_m * 1e3, 2), round(parameters.x_ref_max_m * 1e3, 2)
            slider.props.update(min=low, max=high)
            slider.update()
            ends.text = f"{low:g} .. {high:g} mm, steps of {parameters.x_ref_step_max_m * 1e3:.2g} mm at most"
        if state is not None and state.HasField("x_ref_m") and not abs(state.x_ref_m - followed[0]) < COUNT_M:
            followed[0] = state.x_ref_m
            if not busy:
                slider.value = number.value = round(state.x_ref_m * 1e3, 3)

    ui.timer(_FOLLOW_S, follow)


def _excitation(place: Place) -> None:
    with ui.element("div").classes("fields"):
        shape = ui.select(_SHAPES, value=pb.SHAPE_RECTANGLE, label="shape").props("dense outlined")
        where = ui.select({True: "reference", False: "input u_c"}, value=True, label="on").props("dense outlined")
        amplitude = ui.number("amplitude, mm", value=0.5, step=0.1).props("dense outlined")
        offset = ui.number("around, mm", value=2.5, step=0.1).props("dense outlined")
        period = ui.number("period, s", value=2.0, min=0.0, step=0.1).props("dense outlined")
        period_end = ui.number("last period, s", value=0.1, min=0.0, step=0.1).props("dense outlined")
        duration = ui.number("for, s", value=20.0, min=0.0, step=1.0).props("dense outlined")
    period_end.bind_visibility_from(shape, "value", value=pb.SHAPE_CHIRP)

    def units() -> None:
        unit = "mm" if where.value else "V"
        amplitude.props(f'label="amplitude, {unit}"')
        offset.props(f'label="around, {unit}"')

    async def start() -> None:
        values = [amplitude.value, offset.value, period.value, period_end.value, duration.value]
        if any(value is None for value in values):
            tell(pb.CommandReply(text="A number of the excitation is missing."))
            return
        scale = 1e-3 if where.value else 1.0
        excite = pb.Excite(
            shape=shape.value,
            on_reference=bool(where.value),
            amplitude=values[0] * scale,
            offset=values[1] * scale,
            period_s=values[2],
            period_end_s=values[3] if shape.value == pb.SHAPE_CHIRP else 0.0,
            seed=1,
            duration_s=values[4],
        )
        await place.send(pb.Command(excite=excite))

    def end() -> Awaitable[pb.CommandReply]:
        return place.send(pb.Command(excite=pb.Excite(shape=pb.SHAPE_NONE, on_reference=bool(where.value))))

    where.on_value_change(units)
    with ui.element("div").classes("row-of"):
        ui.button("Start excitation", on_click=start).props("unelevated no-caps")
        ui.button("End it", on_click=end).props("outline no-caps")


def gains(place: Place) -> None:
    """Gains from a file: shown, then sent."""
    if not place.console.may(place.session, "set_gains"):
        return

    async def take(event: events.UploadEventArguments) -> None:
        upload.reset()
        preview.clear()
        try:
            command = parse_gains(await event.file.read(), place.parameters())
        except DataError as error:
            with preview:
                ui.label(f"\u2715 {event.file.name}: {error}").classes("refused")
            return
        with preview:
            ui.label(
                f"{event.file.name}: {'PID' if command.law == pb.LAW_PID else 'LQI'}. Nothing is sent yet."
            ).classes("hint")
            with ui.element("table").classes("gains-table"):
                for row in [{"name": "", "now": "now", "new": "new", "unit": ""}, *rows(command, place.parameters())]:
                    with ui.element("tr"):
                        for name in ("name", "now", "new", "unit"):
                            with ui.element("td"):
                                ui.label(row[name])

            async def send() -> None:
                if (await place.send(pb.Command(set_gains=command))).accepted:
                    preview.clear()

            with ui.element("div").classes("row-of"):
                ui.button("Send these gains to the board", on_click=send).props("unelevated no-caps")
                ui.button("Discard", on_click=preview.clear).props("outline no-caps")

    with _card("Gains from a file"):
        upload = ui.upload(
            label="JSON of board51 design, or TOML", on_upload=take, max_file_size=MAX_BYTES, auto_upload=True
        ).classes("upload")
        upload.props("flat bordered accept=.json,.toml")
        upload.props.update({"headers": [{"name": TOKEN_HEADER, "value": place.session.csrf}]})
        preview = ui.element("div").classes("preview")


def recording(place: Place) -> None:
    """Start, mark, stop."""
    if not place.console.may(place.session, "recording"):
        return
    with _card("Recording"):
        said = ui.label("").classes("hint")
        with ui.element("div").classes("row-of"):
            title = ui.input("name").props("dense outlined maxlength=16")
            begin = act(
                "Start", lambda: place.console.start_recording(place.session, place.board, str(title.value or ""))
            )
            finish = act("Stop recording", lambda: place.console.stop_job(place.session, "record", place.board))
        with ui.element("div").classes("row-of"):
            remark = ui.input("remark").props("dense outlined maxlength=150")
            act("Mark now", lambda: place.console.mark(place.session, place.board, str(remark.value or "")))

    def follow() -> None:
        job = place.console.jobs.get("record", place.board)
        running = job is not None and job.running
        begin.set_visibility(not running)
        finish.set_visibility(running)
        if job is None:
            said.text = "The gateway's own log runs always; this makes a file of its own."
        else:
            said.text = f"{'●' if running else '○'} {job.title}, {job.standing}: {job.lines[-1] if job.lines else ''}"

    ui.timer(_FOLLOW_S, follow)


def campaign(place: Place) -> None:
    """The paper's experiments, with their progress."""
    if not place.console.may(place.session, "campaign"):
        return
    console, session, board = place.console, place.session, place.board
    with _card("Campaign"):
        with ui.element("div").classes("row-of"):
            quick = act("Run quick (35 s)", lambda: console.start_campaign(session, board, quick=True))
            full = act("Run all (2 min)", lambda: console.start_campaign(session, board, quick=False))
            end = act("Interrupt and park the ball", lambda: console.stop_job(session, "campaign", board))
        said = ui.label("").classes("hint")
        lines = ui.label("").classes("job-lines")

    def follow() -> None:
        job = console.jobs.get("campaign", board)
        running = job is not None and job.running
        quick.set_visibility(not running)
        full.set_visibility(not running)
        end.set_visibility(running)
        said.text = f"{job.title}: {job.standing}" if job is not None else "The board must be idle. It moves the ball."
        # A table's columns do not fit into a card: what stood in columns is separated by dots.
        shown = list(job.lines)[-_LINES_SHOWN:] if job is not None else []
        lines.text = "\n".join(_GAPS.sub(" \u00b7 ", line.strip()) for line in shown)

    ui.timer(_FOLLOW_S, follow)
