"""The ground as the filter's steps ask for it."""

import tracemalloc

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context


def test_the_ground_of_a_way_of_100_km_is_not_kept_whole():
    context = Context(EkfConfig(), None, None, lambda north_m, east_m: 0.1 * north_m)
    tracemalloc.start()
    for north_m in range(0, 100_000, 5):
        patch = context.patch(float(north_m), 0.0)
        assert patch is not None
        assert abs(patch.height_m - 0.1 * north_m) < 1e-6
    most_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most_bytes < 4e6
