"""Print how the exported graph agrees with PyTorch on real pictures, and how long it takes.

python export/verify.py models/vwnav_default.onnx runs/default/last.pt [PICTURE ...]
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # so that `python export/...` works

from export import export_onnx, parity
from models.extractor import Extractor
from models.network import SIZE_MULTIPLE_PX
from training.data import data_folder


def pictures_to_check(given: list[Path]) -> list[Path]:
    """The pictures named, else a dozen of the training set, one per source."""
    folder = data_folder()
    if given or folder is None:
        return given
    sources = sorted(p for p in (folder / "train").glob("*/*") if p.is_dir())
    return [sorted(p for p in source.glob("*") if p.suffix == ".jpg")[0] for source in sources[:12]]


def read_grey(path: Path) -> NDArray[np.uint8]:
    """Read a picture as grey and cut it to a size that the network takes."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise export_onnx.ExportError(f"no readable picture at {path}")
    height, width = (side // SIZE_MULTIPLE_PX * SIZE_MULTIPLE_PX for side in grey.shape)
    return np.ascontiguousarray(grey[:height, :width])


def main(arguments: list[str] | None = None) -> int:
    """Run the command; 0 where all agree, 1 where one does not."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("pictures", type=Path, nargs="*")
    given = parser.parse_args(arguments)
    session = parity.open_session(given.model)
    metadata = session.get_modelmeta().custom_metadata_map
    print("model:", metadata)
    agree = True
    try:
        network = export_onnx.load_network(given.checkpoint)
        expected, found = export_onnx.feature_set_id(network), metadata.get("feature_set_id")
        if expected != found:
            raise export_onnx.ExportError(
                f"{given.model} is {found}, but the checkpoint makes {expected}"
            )
        named = [
            (path.parent.name + "/" + path.name, read_grey(path))
            for path in pictures_to_check(given.pictures)
        ]
    except export_onnx.ExportError as error:
        print(f"verify: {error}", file=sys.stderr)
        return 1
    extractor = Extractor(network)
    for name, picture in named or [
        (f"drawn {i}", p) for i, p in enumerate(parity.drawn_pictures(6))
    ]:
        result = parity.compare(session, extractor, picture, max_keypoints=1000)
        feed = {"image": picture[None, None], "max_keypoints": np.array([1000], np.int64)}
        times_ms = []
        for _ in range(10):
            start = time.perf_counter()
            session.run(None, feed)
            times_ms.append(1e3 * (time.perf_counter() - start))
        agree &= result.ok
        size = f"{picture.shape[1]}x{picture.shape[0]}"
        verdict = "ok  " if result.ok else "FAIL"
        time_ms = f"{statistics.median(times_ms):.1f} ms on one thread"
        print(f"{verdict} {name:50s} {size:>9s}  {result}, {time_ms}")
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main())
