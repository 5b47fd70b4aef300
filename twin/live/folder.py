"""A campaign folder from what was heard: one MCAP per recording, `campaign.toml` around them.

Rule: a new folder each time; nothing is overwritten, and what was diagnosed can be diagnosed again.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.plant_card import EMULATED, card_plant
from protocol.campaign import Campaign, Controller, OperatingPoint, Plant, Recording
from protocol.campaign_text import emit
from protocol.errors import DataError
from twin.live.pieces import Piece
from twin.live.source import LiveData, in_force
from twin.model.parameters import Model, parse_model
from twin.readers.log import TwinLog


def write(live: LiveData, pieces: Sequence[Piece], plant: Plant, out: Path, *, site: str, board: str) -> Path:
    """The folder, below `out`.  Raises DataError where it cannot be written."""
    folder = out / f"live-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}"
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise DataError(f"{folder} cannot be made ({error.strerror})", remedy="Give another --out") from None
    for piece in pieces:
        with TwinLog(folder / f"{piece.name}.mcap") as log:
            if live.parameters:
                session = piece.states[0].session if piece.states else live.parameters[-1].session
                # Those of its own session: the ticks of another one do not belong to these samples.
                known = [announced for announced in live.parameters if announced.session == session] or live.parameters
                at_ns = piece.states[0].host_time_ns if piece.states else known[-1].host_time_ns
                key = topics.key(site, board, "parameters")
                log.write(key, known[-1], message_type=pb.Parameters, log_time_ns=at_ns)
            for topic, messages in (("state", piece.states), ("capture", piece.captures)):
                for message in messages:
                    key, at_ns = topics.key(site, board, topic), message.host_time_ns
                    log.write(key, message, message_type=type(message), log_time_ns=at_ns)
    campaign = Campaign(
        where=str(folder / "campaign.toml"),
        folder=folder,
        plant=plant,
        controller=controller_of(live.parameters),
        recordings=tuple(Recording(file=f"{piece.name}.mcap", kind=piece.kind, use=piece.use) for piece in pieces),
    )
    comments = [f"Made by `board51 diagnose --live` from {live.where}, board {site}/{board}."]
    if campaign.controller is None:
        comments.append("No [controller]: the board's gains changed, or did not arrive.")
    (folder / "campaign.toml").write_text(emit(campaign, comments=comments), encoding="utf-8")
    return folder


def plant_of(live: LiveData) -> Plant:
    """Return the plant of the rig's card, else of the live twin's model, or of the nominal CE 152 if no twin is heard.

    The nominal model is what a twin runs on before anybody has stated a plant: its plant is assumed.  The card of an
    emulated board, which nobody wrote, counts where the plant of the model is assumed.
    """
    stated = card_plant(live.card)
    nominal = Model.load("ce152")
    model = parse_model(live.model_json, where="the live twin's model") if live.model_json else nominal
    assumed = model.plant.assumed or model == nominal
    if stated is not None and live.card is not None and (assumed or live.card.who != EMULATED):
        return stated
    return replace(model.plant, assumed=assumed)


def controller_of(parameters: Sequence[pb.Parameters]) -> Controller | None:
    """The law, where one set of gains was in force throughout."""
    # Without the session: gains that a reset did not change are the same law.
    laws = {in_force(announced)[1:] for announced in parameters}
    if len(laws) != 1:
        return None
    law, gains, i_c_a, x_m, u_c_v = laws.pop()
    if len(gains) != 4:
        return None
    return Controller(
        kind="pid" if law == pb.LAW_PID else "lqi",
        gains=(gains[0], gains[1], gains[2], gains[3]),
        operating_point=OperatingPoint(i_c_a=i_c_a, x_m=x_m, u_c_v=u_c_v),
    )


def changes_of(parameters: Sequence[pb.Parameters]) -> list[tuple[int, int]]:
    """Return (session, tick) from which other values were in force."""
    return [
        (after.session, after.from_tick) for before, after in pairwise(parameters) if after.session == before.session
    ]
