"""The jobs that a request may start, by their kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from gateway.views.hmi.actions import Order
from gateway.views.hmi.model.design_work import design, fly, forecast
from gateway.views.hmi.model.work import ModelWork
from protocol.bus import board51_pb2 as pb


def _campaign(work: ModelWork, order: Order) -> pb.CommandReply:
    if order.flag("resume"):
        return work.resume_campaign(order)
    if order.flag("fly"):
        return fly(work, order)
    return work.add_experiment(order) if "experiment" in order.table else work.start_campaign(order)


def _diagnose(work: ModelWork, order: Order) -> pb.CommandReply:
    return work.diagnose_live(order) if order.flag("live") else work.diagnose(order)


STARTS: Mapping[str, Callable[[ModelWork, Order], pb.CommandReply]] = {
    "record": lambda work, order: work.actions.start_recording(order),
    "campaign": _campaign,
    "identify": ModelWork.identify,
    "validate": ModelWork.validate,
    "diagnose": _diagnose,
    "compare": ModelWork.compare,
    "design": design,
    "forecast": forecast,
    "bode": ModelWork.bode,
    "hand-over": ModelWork.hand_over,
    "replay": lambda work, order: work.actions.start_replay(order),
}
