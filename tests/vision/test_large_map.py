"""A search of a large map: it takes as long as it takes, and no more memory."""

import sys
import weakref
from pathlib import Path

import numpy as np
from vision_scenes import CAMERA, frame_at, ground_pack, texture

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "maps"))
from large_map import spread

from vwnav.maps.pack import MapPack
from vwnav.types import Prior
from vwnav.vision.localizer import Localizer
from vwnav.vision.rivals import KEPT_COARSE

FIRST = 3  # pieces that the pack itself and the query hold on to
WAYS = 4


def test_a_search_holds_on_to_the_pieces_of_its_best_places_alone(
    tmp_path, ground, learned, monkeypatch
):
    path = ground_pack(tmp_path / "large.mbtiles", ground, (learned,))
    spread(path, WAYS)
    with MapPack.open(path) as pack:
        read, held, features_in = [], [], pack.features_in

        def counted(*window):
            piece = features_in(*window)
            read.append(weakref.ref(piece.origin_px))
            held.append(sum(each() is not None for each in read))
            return piece

        monkeypatch.setattr(pack, "features_in", counted)
        frame = frame_at(texture(7), 0.0, 0.0, 90.0, rng=np.random.default_rng(3))
        prior = Prior(agl_m=90.0, sigma_agl_ratio=0.1, roll_rad=0.0, pitch_rad=0.0)
        Localizer(pack, learned, CAMERA).localize(frame, prior, 0)
    assert max(held) <= KEPT_COARSE + FIRST
