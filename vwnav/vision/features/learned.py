"""The learned features: one ONNX graph from the image to keypoints, scores and descriptors."""

import math
from pathlib import Path
from typing import Literal

import numpy as np
import onnxruntime
from numpy.typing import NDArray

import vwnav
from vwnav.errors import ModelError
from vwnav.types import Features, Gray
from vwnav.vision.features.opencv import check_gray

SIZE_MULTIPLE_PX = 32  # the graph halves the image five times
BORDER_PX = 4  # the graph finds nothing nearer to an edge; here the same at edges it cannot see
LOG10_PER_DECADE = "log10_per_decade"  # in the metadata: see `vwnav.vision.matching`
# Of a model whose own value has not been measured: more than any that was (docs/benchmarks.md).
CAUTIOUS_LOG10_PER_DECADE = 5.0
_INPUTS = {"image": "tensor(uint8)", "max_keypoints": "tensor(int64)"}
_OUTPUTS = ("keypoints", "scores", "descriptors")


def released_model(name: str = "default") -> Path:
    """Where released weights are: in an installed wheel, else in the source tree.

    Args:
        name: size of the network, and precision where it is not float: "default", "nano", ...

    Raises:
        ModelError: in neither place.
    """
    package = Path(vwnav.__file__).parent
    for folder in (package / "weights", package.parent / "models"):
        place = folder / f"vwnav_{name}.onnx"
        if place.is_file():
            return place
    raise ModelError(
        f"the released model vwnav_{name}.onnx is missing: install vwnav again, "
        "or name a model with --model"
    )


def find_model(given: Path | None) -> Path:
    """The file of a model: the one that is given, by path or released name, else the default.

    Raises:
        ModelError: there is none.
    """
    if given is None:
        return released_model()
    if given.is_file():
        return given
    released = sorted(
        path.stem.removeprefix("vwnav_") for path in released_model().parent.glob("vwnav_*.onnx")
    )
    if str(given) in released:
        return released_model(str(given))
    raise ModelError(
        f"no model at {given}: give the path of a vwnav .onnx file, or one of {', '.join(released)}"
    )


class LearnedFeatures:
    """The network behind the `FeatureExtractor` protocol, on onnxruntime alone."""

    name: Literal["learned"] = "learned"

    def __init__(self, path: Path | None = None, *, threads: int = 1) -> None:
        """Load a model and run it once.

        Args:
            path: the ONNX file, or the name of released weights such as "nano"; "default" when
                not given.
            threads: cores that one extraction may use.

        Raises:
            ModelError: missing, damaged, or not made by this project's export.
        """
        self._path = find_model(path)
        self._session = _open(self._path, threads)
        facts = _check(self._session, self._path)
        self.feature_set_id = facts["feature_set_id"]
        # `vwnav bench significance --write` puts it there.
        self.log10_per_decade = _log10_per_decade(facts, self._path)
        # The first run allocates and compiles; and a graph that loads may still not run.
        self.extract(np.zeros((2 * SIZE_MULTIPLE_PX, 2 * SIZE_MULTIPLE_PX), np.uint8), 1)

    def extract(self, gray: Gray, max_keypoints: int) -> Features:
        """Detect and describe.

        Args:
            gray: (h, w) uint8 of any size.
            max_keypoints: at most so many, the ones of the highest score.

        Returns:
            Features with uv (n, 2), pixels, centre convention, and descriptors of unit length.

        Raises:
            ValueError: not a gray image.
            ModelError: the graph fails.
        """
        check_gray(gray)
        h, w = gray.shape
        pad_h, pad_w = -h % SIZE_MULTIPLE_PX, -w % SIZE_MULTIPLE_PX
        padded = np.pad(gray, ((0, pad_h), (0, pad_w)), mode="edge")
        # Keypoints of the padding are dropped below, so some more are asked for.
        wanted = max(0, math.ceil(max_keypoints * padded.size / gray.size))
        if gray.min() == gray.max():
            wanted = 0  # the net has to rank something; without any contrast there is nothing
        uv, scores, descriptors = self._run(padded, wanted)
        inside = np.ones(len(uv), bool)
        if pad_w:
            inside &= uv[:, 0] < w - BORDER_PX
        if pad_h:
            inside &= uv[:, 1] < h - BORDER_PX
        kept = np.flatnonzero(inside)[: max(0, max_keypoints)]
        return Features(uv[kept], descriptors[kept], scores[kept])

    def _run(
        self, padded: Gray, wanted: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        inputs = {"image": padded[None, None], "max_keypoints": np.array([wanted], np.int64)}
        try:
            uv, scores, descriptors = self._session.run(list(_OUTPUTS), inputs)
        except Exception as error:  # onnxruntime's own errors have no common base
            raise ModelError(
                f"the model {self._path} does not run ({_first_line(error)}): "
                "install vwnav again or give another --model"
            ) from error
        return uv, scores, descriptors


def _open(path: Path, threads: int) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Two threads that wait awake take the link's turns: 98 ms of processor time an image, not 48.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3  # errors only; they come as exceptions too
    options.enable_mem_pattern = False  # one is kept for each size, and views are of all sizes
    try:
        return onnxruntime.InferenceSession(
            path.read_bytes(), options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:  # onnxruntime's own errors have no common base
        raise ModelError(
            f"the model {path} is damaged ({_first_line(error)}): "
            "install vwnav again or give another --model"
        ) from error


def _check(session: onnxruntime.InferenceSession, path: Path) -> dict[str, str]:
    """The model's facts about itself."""
    inputs = {value.name: value.type for value in session.get_inputs()}
    outputs = {value.name for value in session.get_outputs()}
    facts: dict[str, str] = session.get_modelmeta().custom_metadata_map
    if inputs != _INPUTS or not outputs.issuperset(_OUTPUTS) or not facts.get("feature_set_id"):
        raise ModelError(
            f"the model {path} is not one of vwnav: make one with export/export_onnx.py"
        )
    return facts


def _log10_per_decade(facts: dict[str, str], path: Path) -> float:
    said = facts.get(LOG10_PER_DECADE, "")
    if not said:
        return CAUTIOUS_LOG10_PER_DECADE
    try:
        value = float(said)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise ModelError(
            f"the model {path} says {LOG10_PER_DECADE} {said!r}: "
            "measure it with `vwnav bench significance --write`"
        )
    return value


def _first_line(error: Exception) -> str:
    lines = str(error).splitlines()
    return lines[0][:160] if lines else type(error).__name__
