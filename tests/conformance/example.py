"""The driver of docs/examples/udp_stage, which passes every check, and what it is changed with."""

import sys
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "udp_stage"
if str(EXAMPLE) not in sys.path:
    sys.path.append(str(EXAMPLE))

from test_udp_stage import TestUdpStage as UdpStageContract  # noqa: E402
from test_udp_stage import UdpPeer, WatchedDevice  # noqa: E402
from udp_stage import wire  # noqa: E402
from udp_stage.driver import UdpStage, UdpStageOptions  # noqa: E402

__all__ = ["UdpPeer", "UdpStage", "UdpStageContract", "UdpStageOptions", "WatchedDevice", "wire"]
