"""The controls of a rig's page.  Each is a card; a control that the user may not use is left out.

A control is HTML that static/acts.js turns into a request.  It is a button with `data-command` (a pb.Command as JSON)
or `data-job`, or a form with `data-form`, whose numbers acts.js puts into a command.
"""

from __future__ import annotations

import json
from collections.abc import Callable

from gateway.views.hmi.html.markup import Markup, join, tag
from gateway.views.hmi.texts import text_of, texts_of
from protocol.bus import board51_pb2 as pb

_MODES = {"idle": pb.MODE_IDLE, "open loop": pb.MODE_OPEN_LOOP, "closed loop": pb.MODE_CLOSED_LOOP}


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
    def button(word: str, mode: pb.Mode) -> Markup:
        text, command = texts_of("mode_button")[word], json.dumps({"set_mode": {"mode": pb.Mode.Name(mode)}})
        return tag("button", text, type="button", class_="mode", data_mode=word, data_command=command,
                   data_last_known=text_of("controls.last_known"))  # fmt: skip

    return _card(text_of("controls.mode"), tag("div", *(button(*mode) for mode in _MODES.items()), class_="modes"))


def _reference() -> Markup:
    slider = tag("input", type="range", name="slide", min="0", max="6", step="0.01", value="0", data_slider="reference",
                 aria_label=text_of("reference.slider"))  # fmt: skip
    fields = _row(
        _number("mm", "mm", None, data_number="reference"), tag("button", text_of("reference.set"), class_="filled")
    )
    words = [tag("div", data_live=name, class_="hint") for name in ("reference-now", "reference-range")]
    form = tag("form", slider, fields, *words, data_form="reference", class_="reference")
    return _card(text_of("reference.title"), form)


def _excitation() -> Markup:
    shapes = {f"SHAPE_{shape.upper()}": text for shape, text in texts_of("shape").items()}
    fields = tag(
        "div",
        _number(text_of("excitation.amplitude", unit="mm"), "amplitude", 0.5),
        _number(text_of("excitation.offset", unit="mm"), "offset", 2.5),
        _number(text_of("excitation.period"), "period", 2.0, min="0"),
        _number(text_of("excitation.last_period"), "period_end", 0.1, min="0"),
        _number(text_of("excitation.duration"), "duration", 20.0, min="0"),
        class_="fields",
    )
    acts = _row(
        tag("button", text_of("excitation.start"), class_="filled"),
        tag("button", text_of("excitation.end"), type="button", class_="plain", data_act="end-excitation"),
    )
    shape = _choice(text_of("excitation.shape"), "shape", shapes, "SHAPE_RECTANGLE")
    signals = {"reference": text_of("excitation.on_reference"), "input": text_of("excitation.on_input")}
    signal = _choice(text_of("excitation.signal"), "on", signals, "reference")
    return _card(text_of("excitation.title"), tag("form", shape, signal, fields, acts, data_form="excitation"))


def _recording() -> Markup:
    begin = tag("button", text_of("recording.start"), class_="plain")
    start = tag("form", _text(text_of("recording.name"), "title", 16), begin, data_form="recording", class_="row-of",
                data_idle="record")  # fmt: skip
    end = job(text_of("recording.stop"), "record", "stop")
    stop = tag("div", end, class_="row-of", data_running="record", hidden=True)
    remark = tag("button", text_of("recording.mark"), class_="plain")
    mark = tag("form", _text(text_of("recording.remark"), "text", 150), remark, data_form="mark", class_="row-of")
    hint = tag("div", data_live="record-said", class_="hint")
    return _card(text_of("recording.title"), hint, start, stop, mark)


def _gains() -> Markup:
    hint = tag("span", text_of("gains.file"))
    choose = tag("label", hint, tag("input", type="file", accept=".json,.toml", data_file="gains"), class_="field")
    return _card(text_of("gains.title"), join(choose, tag("div", class_="preview")))
