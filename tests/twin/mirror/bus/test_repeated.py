"""Each message that a twin repeats bears the time of its repetition, by the gateway's clock."""

from __future__ import annotations

from itertools import pairwise

import pytest

from protocol.bus import board51_pb2 as pb
from tests.harness.ports import free_endpoint
from tests.harness.twin.rig import Rig
from tests.harness.twin.twin_bus import Subscriber, router, wait_for_count
from twin.mirror.bus.handover import believe
from twin.mirror.bus.watched import REPEAT_S, Namer, Watched
from twin.mirror.output import Output
from twin.mirror.regime import Regime
from twin.model.parameters import Model

STEP_S = 1.02 * REPEAT_S
STEP_NS = round(STEP_S * 1e9)
REPEATED: dict[str, type[pb.TwinModel | pb.TwinAlarms | pb.TwinDiagnosis]] = {
    "twin/model": pb.TwinModel,
    "twin/alarms": pb.TwinAlarms,
    "twin/diagnosis": pb.TwinDiagnosis,
}


class Silent:
    """A namer that names nothing."""

    def take(self, state: pb.State, output: Output, regime: Regime | None) -> pb.TwinDiagnosis | None:
        return None

    def use(self, model: Model) -> None: ...

    def forget(self) -> None: ...


def namer(model: Model) -> Namer:
    return Silent()


def repeated(host_time_ns: int) -> dict[str, list[int]]:
    """The times of what a twin repeats, by topic: after one sample of this time there is silence."""
    (state,) = Rig().run(1, 0.0)
    state.host_time_ns = host_time_ns
    with router(free_endpoint()) as session:
        subscriber = Subscriber(session, "lab")
        twin = Watched(session, "lab", "rig", believe(Model.load("ce152")), None, namers=namer)
        twin.take(state, now_s=100.0)
        for step in range(1, 4):
            twin.look_at_the_clock(now_s=100.0 + step * STEP_S)
        for topic in REPEATED:
            wait_for_count(lambda t=topic: len(subscriber.payloads[f"lab/rig/{t}"]), 4, topic)  # type: ignore[misc]  # default in a lambda
    return {
        topic: [kind.FromString(data).host_time_ns for data in subscriber.payloads[f"lab/rig/{topic}"]]
        for topic, kind in REPEATED.items()
    }


def test_a_repetition_bears_the_time_at_which_it_is_sent_also_while_the_rig_is_silent() -> None:
    for times_ns in repeated(10**18).values():
        assert times_ns[0] == 10**18
        assert [after - before for before, after in pairwise(times_ns)] == [STEP_NS] * 3


@pytest.mark.parametrize(("host_time_ns", "last_ns"), [(0, 0), ((1 << 64) - 2, (1 << 64) - 1)])
def test_a_time_that_no_clock_has_does_no_harm(host_time_ns: int, last_ns: int) -> None:
    for times_ns in repeated(host_time_ns).values():
        assert times_ns == [host_time_ns, last_ns, last_ns, last_ns]
