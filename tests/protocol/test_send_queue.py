"""Tests of the order of writing: a STOP that was begun is finished, whatever is given up meanwhile."""

from __future__ import annotations

import pytest

from protocol.wire.exchange import Command, SendQueue
from protocol.wire.messages import Value
from tests.harness.protocol.port import take_output

BEGUN = 3  # bytes of a frame that the port has taken


def command(number: int, name: str, **values: Value) -> Command:
    made = Command(token=number, name=name, values=dict(values))
    made.number(number)
    return made


@pytest.fixture
def mode() -> Command:
    return command(1, "SET_MODE", mode=2)


@pytest.fixture
def stop() -> Command:
    return command(2, "STOP")


def begun(first: Command, *rest: Command) -> SendQueue:
    queue = SendQueue()
    queue.add(first)
    queue.wrote(BEGUN)
    for other in rest:
        queue.add(other)
    return queue


def test_a_stop_that_was_begun_is_finished_whoever_is_given_up(mode: Command, stop: Command) -> None:
    queue = begun(stop, mode)

    queue.drop(mode)
    queue.drop(stop)

    assert take_output(queue) == stop.frame[BEGUN:]


def test_a_stop_that_waits_goes_out_after_it_was_given_up(mode: Command, stop: Command) -> None:
    queue = begun(mode, stop)

    queue.drop(stop)
    queue.withdraw(stop)

    assert take_output(queue) == mode.frame[BEGUN:] + stop.frame


def test_what_was_given_up_is_not_finished(mode: Command, stop: Command) -> None:
    queue = begun(mode, stop)

    queue.drop(mode)

    assert take_output(queue) == stop.frame


def test_the_rest_of_a_frame_is_of_the_command_that_began_it(mode: Command) -> None:
    other = command(3, "SET_REFERENCE", x_ref=100)
    queue = begun(mode, other)

    queue.drop(other)

    assert take_output(queue) == mode.frame[BEGUN:]
