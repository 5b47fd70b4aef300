"""The controls of a rig's page.  Each is a card; what may not be used is not there.

A control is HTML that static/acts.js turns into a request: a button with `data-command` (a pb.Command as JSON) or
`data-job`, a form with `data-form`, whose numbers acts.js puts into a command.
"""

from __future__ import annotations

import json
from collections.abc import Callable

from gateway.views.hmi.html.markup import Markup, join, tag
from protocol.bus import board51_pb2 as pb

_MODES = (("Idle", "idle", pb.MODE_IDLE), ("Open loop", "open loop", pb.MODE_OPEN_LOOP),
          ("Closed loop", "closed loop", pb.MODE_CLOSED_LOOP))  # fmt: skip
_SHAPES = ("step", "rectangle", "sawtooth", "prbs", "multisine", "chirp")


def cards(may: Callable[[str], bool]) -> list[Markup]:
    """Return the cards of the actions that `may` allows."""
    made = (("set_mode", _mode), ("set_reference", _reference), ("excite", _excitation), ("recording", _recording),
            ("set_gains", _gains))  # fmt: skip
    return [make() for act, make in made if may(act)]


def job(text: str, kind: str, act: str, *, then: str = "", **options: str | bool) -> Markup:
    """Return a button that starts or stops a job; `then` is the page to open if the request is accepted."""
    request = json.dumps({"kind": kind, "act": act, **options})
    return tag("button", text, type="button", class_="plain", data_job=request, data_then=then or None)


def _card(title: str, *content: Markup) -> Markup:
    return tag("section", tag("h2", title, class_="card-title"), *content, class_="card")


def _row(*content: Markup) -> Markup:
    return tag("div", *content, class_="row-of")


def _number(label: str, name: str, value: float | None, **attributes: str) -> Markup:
    field = tag(
        "input",
        type="number",
        name=name,
        value=None if value is None else f"{value:g}",
        step="any",
        required=True,
        **attributes,
    )
    return tag("label", tag("span", label, data_label=name), field, class_="field")


def _text(label: str, name: str, longest: int) -> Markup:
    field = tag("input", name=name, maxlength=longest, autocomplete="off")  # a list of old entries would want Esc
    return tag("label", tag("span", label), field, class_="field")


def _choice(label: str, name: str, options: dict[str, str], chosen: str) -> Markup:
    """Return radio buttons.  In a list that opens, people close it with Esc by habit, and Esc is STOP."""
    buttons = [
        tag("label", tag("input", type="radio", name=name, value=value, checked=value == chosen), tag("span", text))
        for value, text in options.items()
    ]
    return tag("fieldset", tag("legend", label), *buttons, class_="choice")


def _mode() -> Markup:
    def button(text: str, word: str, mode: pb.Mode) -> Markup:
        command = json.dumps({"set_mode": {"mode": pb.Mode.Name(mode)}})
        return tag("button", text, type="button", class_="mode", data_mode=word, data_command=command)

    return _card("Mode", tag("div", *(button(*mode) for mode in _MODES), class_="modes"))


def _reference() -> Markup:
    slider = tag("input", type="range", name="slide", min="0", max="6", step="0.01", value="0", data_slider="reference",
                 aria_label="Reference in mm")  # fmt: skip
    fields = _row(_number("mm", "mm", None, data_number="reference"), tag("button", "Set", class_="filled"))
    words = [tag("div", data_live=name, class_="hint") for name in ("reference-now", "reference-range")]
    return _card("Reference", tag("form", slider, fields, *words, data_form="reference", class_="reference"))


def _excitation() -> Markup:
    shapes = {f"SHAPE_{shape.upper()}": shape for shape in _SHAPES}
    fields = tag(
        "div",
        _number("amplitude, mm", "amplitude", 0.5),
        _number("around, mm", "offset", 2.5),
        _number("period, s", "period", 2.0, min="0"),
        _number("last period, s", "period_end", 0.1, min="0"),
        _number("duration, s (0: endless)", "duration", 20.0, min="0"),
        class_="fields",
    )
    acts = _row(
        tag("button", "Start excitation", class_="filled"),
        tag("button", "End it", type="button", class_="plain", data_act="end-excitation"),
    )
    shape = _choice("shape", "shape", shapes, "SHAPE_RECTANGLE")
    where = _choice("on", "on", {"reference": "reference", "input": "input u_c"}, "reference")
    return _card("Excitation", tag("form", shape, where, fields, acts, data_form="excitation"))


def _recording() -> Markup:
    start = tag("form", _text("name", "title", 16), tag("button", "Start", class_="plain"), data_form="recording",
                class_="row-of", data_idle="record")  # fmt: skip
    stop = tag("div", job("Stop recording", "record", "stop"), class_="row-of", data_running="record", hidden=True)
    mark = tag("form", _text("remark", "text", 150), tag("button", "Mark now", class_="plain"), data_form="mark",
               class_="row-of")  # fmt: skip
    return _card("Recording", tag("div", data_live="record-said", class_="hint"), start, stop, mark)


def _gains() -> Markup:
    hint = tag("span", "JSON of board51 design, or TOML")
    choose = tag("label", hint, tag("input", type="file", accept=".json,.toml", data_file="gains"), class_="field")
    return _card("Gains from a file", join(choose, tag("div", class_="preview")))
