"""Tests of a client without a rig: its messages and its properties."""

from __future__ import annotations

import importlib.util
import math
import subprocess
import sys

import pytest

import gateway.client
from gateway.client import CommandRefusedError, Rig, Sample, Samples
from protocol.bus import board51_pb2 as pb
from protocol.errors import ConfigError, ServiceError, UsageError
from tests.harness.ports import free_port


def test_who_may_not_send_a_command_is_told_to_be_somebody_else() -> None:
    reply = pb.CommandReply(refused_by="gateway", reason="not-allowed", text="ana (viewer) may not excite.")

    error = CommandRefusedError(pb.Command(excite=pb.Excite()), reply)

    assert "identity" in error.remedy


def test_wrong_options_are_named() -> None:
    for words in ({"connect": "here"}, {"site": "A/B"}, {"identity": "no-such-folder"}):
        with pytest.raises(ConfigError):
            Rig("rig", **words)  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(UsageError):
        Rig("rig", timeout_s=0.0)
    with pytest.raises(ServiceError), Rig("rig", connect=f"tcp/127.0.0.1:{free_port()}"):
        pass


def test_what_was_not_measured_is_nan() -> None:
    sample = Sample.of(pb.State(tick=1, x_m=0.0))

    assert sample.x_m == 0.0
    assert math.isnan(sample.i_c_a)
    assert len(Samples.of([])) == 0


@pytest.mark.skipif(importlib.util.find_spec("pandas") is not None, reason="pandas is installed here")
def test_a_data_frame_needs_pandas_and_says_so() -> None:
    with pytest.raises(UsageError, match="pandas is not installed"):
        Samples.of([]).to_dataframe()


def test_the_package_costs_nothing_until_a_name_is_used() -> None:
    code = "import gateway.client, sys; assert not {'zenoh', 'numpy'} & set(sys.modules)"

    subprocess.run([sys.executable, "-c", code], check=True)
    for name in gateway.client.__all__:
        assert getattr(gateway.client, name).__module__.startswith("gateway.client.")
