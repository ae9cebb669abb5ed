"""What `vwnav fly` does before the flight."""

import pytest

from vwnav.onboard.equipment import is_same_link


@pytest.mark.parametrize(
    ("truth", "same"),
    [
        ("udpin:0.0.0.0:14540", True),
        ("udp://:14540", True),
        ("udpin://127.0.0.1:14560", False),
        ("tcpout:127.0.0.1:14540", False),
        ("nonsense", False),
    ],
)
def test_truth_on_the_autopilots_own_port_is_noticed(truth, same):
    assert is_same_link(truth, "udpin://0.0.0.0:14540") is same
