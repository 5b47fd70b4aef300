"""The whole line on a guarded bus as its users start it: router, gateway, twin, and the commands."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh

import board51
from gateway.access.folder import SecurityFolder
from gateway.config import SecurityConfig, ZenohConfig
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.endpoint import zenoh_config
from tests.harness.gateway.access_peers import Client, GuardedRig, fresh, join
from tests.harness.gateway.gateway_peers import ScriptedBoard, gateway_config, running, wait_for
from tests.harness.gateway.stopped_subscriber import STALL_S, longest_round_s
from tests.harness.ports import free_port
from tests.patience import HANG_S
from twin.mirror.bus.service import TwinService
from twin.model.parameters import Model

pytestmark = pytest.mark.xdist_group("guarded-bus")


@contextmanager
def router(keys: SecurityFolder) -> Iterator[str]:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    with zenoh.open(zenoh.Config.from_json5(keys.router([endpoint]))):
        yield endpoint


@pytest.mark.parametrize("whole_folder", [True, False], ids=["the folder", "its identity alone"])
def test_a_gateway_behind_a_guarded_router(keys: SecurityFolder, whole_folder: bool) -> None:
    directory = keys.path if whole_folder else keys.identity_path("gateway")
    with router(keys) as endpoint, ScriptedBoard() as board:
        config = replace(
            gateway_config(board.url),
            zenoh=ZenohConfig(mode="client", connect=(endpoint,)),
            security=SecurityConfig(directory=str(directory)),
        )
        with running(config), join(endpoint, keys.identity("vic")) as vic, join(endpoint, keys.identity("ben")) as ben:
            wait_for(lambda: vic.states, "states through the router")
            wait_for(lambda: (r := ben.command(ping=pb.Ping())) is not None and r.accepted, "an accepted command")
            refused = ben.command(set_gains=pb.SetGains())

            assert refused is not None
            assert refused.reason == "not-allowed"
            assert ben.command(key="board51/rig/command", ping=pb.Ping()) is None
            alive = vic.session.liveliness().get("board51/*/alive")
            assert [str(token.ok.key_expr) for token in alive if token.ok is not None] == ["board51/rig/alive"]


def test_a_viewer_that_does_not_read_stalls_nobody_else(keys: SecurityFolder) -> None:
    def config(endpoint: str, name: str) -> str:
        return zenoh_config("client", connect=[endpoint], identity=keys.identity(name))

    with router(keys) as endpoint:
        gateway, healthy, viewer = (config(endpoint, name) for name in ("gateway", "ben", "vic"))
        with (
            zenoh.open(zenoh.Config.from_json5(gateway)) as publishing,
            zenoh.open(zenoh.Config.from_json5(healthy)) as reading,
        ):
            asks = topics.command_key("board51", "rig", role="viewer", who="vic")
            assert longest_round_s(publishing, reading, viewer, asks) < STALL_S


def send_twin_command(client: Client, who: str, board: str = "rig") -> list[pb.CommandReply]:
    command = pb.TwinCommand(id="1", who="somebody")
    command.use_model.model_json = "no model"
    key = topics.command_key("board51", board, role=client.identity.role, who=who, topic="twin/command")
    return client.request(command.SerializeToString(), key)


def test_a_twin_takes_models_from_engineers_only(keys: SecurityFolder, caplog: pytest.LogCaptureFixture) -> None:
    with (
        router(keys) as endpoint,
        TwinService(Model.load("ce152"), endpoints=(endpoint,), identity=keys.identity("twin")) as service,
        join(endpoint, keys.identity("gateway")) as gateway,
        join(endpoint, keys.identity("ana")) as ana,
        join(endpoint, keys.identity("ben")) as ben,
    ):

        def introduced() -> bool:
            gateway.session.put("board51/rig/parameters", pb.Parameters(sample_time_s=0.002).SerializeToString())
            return "rig" in service.boards

        wait_for(introduced, "the board at the twin")

        (reply,) = send_twin_command(ana, "ana")
        assert reply.reason == "bad-model"  # it was read: the right is there
        assert "from 'ana'" in caplog.text  # not somebody
        (for_all,) = send_twin_command(ana, "ana", board="*")
        assert for_all.reason == "bad-model"
        assert send_twin_command(ben, "ben") == []
        assert send_twin_command(ana, "ben") == []
        assert ana.request(b"", "board51/rig/twin/command") == []


def test_a_guarded_bus_lets_a_twin_see_that_another_serves_its_boards(keys: SecurityFolder) -> None:
    with (
        router(keys) as endpoint,
        TwinService(Model.load("ce152"), endpoints=(endpoint,), identity=keys.identity("twin")) as first_twin,
        join(endpoint, keys.identity("gateway")) as gateway,
    ):

        def parameters_at(service: TwinService) -> bool:
            gateway.session.put("board51/rig/parameters", pb.Parameters(sample_time_s=0.002).SerializeToString())
            return "rig" in service.boards or service.failure is not None

        wait_for(lambda: parameters_at(first_twin), "the board at the twin")
        with TwinService(Model.load("ce152"), endpoints=(endpoint,), identity=keys.identity("twin")) as second_twin:
            wait_for(lambda: parameters_at(second_twin), "an answer of the second twin")

            assert "A twin already serves every board of site board51" in str(second_twin.failure)
            assert first_twin.failure is None


# -- commands as a user types them


@pytest.fixture(autouse=True)
def signals_as_they_were() -> Iterator[None]:
    """Some commands take over SIGTERM, for a process that is theirs; here it is pytest's."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def typed(rig: GuardedRig, name: str, *words: str) -> int:
    return board51.main([*words, "--connect", rig.endpoint, "--identity", str(rig.folder.identity_path(name))])


def test_send_says_who_may_not(rig: GuardedRig, capsys: pytest.CaptureFixture[str]) -> None:
    assert typed(rig, "ben", "send", "rig", "mode", "closed-loop", "--who", "ana") == 0
    assert typed(rig, "vic", "send", "rig", "mode", "closed-loop") == 1
    assert typed(rig, "vic", "send", "rig", "stop") == 0

    out = capsys.readouterr().out
    assert "accepted" in out
    assert "vic (viewer) may not set mode: it needs the role operator." in out


def test_watch_and_record_read_with_an_identity(
    rig: GuardedRig, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BOARD51_IDENTITY", str(rig.folder.identity_path("vic")))
    bus = ["--connect", rig.endpoint]

    assert board51.main(["watch", *bus, "--topic", "state", "--count", "3", "--timeout", str(HANG_S), "--json"]) == 0
    assert {json.loads(line)["key"] for line in capsys.readouterr().out.splitlines()} == {"board51/rig/state"}


def test_a_log_is_not_replayed_as_the_board_by_a_person(rig: GuardedRig) -> None:
    log = next(rig.logs.glob("*.mcap"))
    with rig.join("vic") as vic:
        old = vic.states[0].session
        code = typed(rig, "ana", "replay", str(log), "--speed", "0", "--wait", "0", "--as", "ghost")
        assert code in (0, 1)
        count = len(vic.states)
        wait_for(lambda: len(vic.states) > count + 50, "states")

        alive_keys = {str(r.ok.key_expr) for r in vic.session.liveliness().get("board51/*/alive") if r.ok}
        assert alive_keys == {"board51/rig/alive"}
        assert {state.session for state in vic.states} == {old}


def test_many_senders_at_once_are_each_known_by_name(rig: GuardedRig) -> None:
    names = ("ana", "ben")
    ids: dict[str, list[str]] = {name: [] for name in names}

    def work(name: str) -> None:
        with rig.join(name) as client:
            for _ in range(10):
                command = fresh(ping=pb.Ping(), who="nobody")
                ids[name].append(command.id)
                client.request(command.SerializeToString())

    with rig.join("vic") as vic:
        threads = [threading.Thread(target=work, args=(name,)) for name in names]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for name in names:
            assert {vic.record_of(id).command.who for id in ids[name]} == {name}


def test_any_zenoh_client_joins_with_the_printed_configuration(
    rig: GuardedRig, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = str(rig.folder.identity_path("ben"))
    assert board51.main(["security", "zenoh-config", folder, "--connect", rig.endpoint]) == 0
    (tmp_path / "ben.json5").write_text(capsys.readouterr().out)

    with zenoh.open(zenoh.Config.from_file(tmp_path / "ben.json5")) as session:
        client = Client(session, rig.folder.identity("ben"))
        wait_for(lambda: client.states, "states")
