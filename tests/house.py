"""How the house is built: what one step enters, import chains, sizes, doubled names.

    python tests/house.py [--json | --functions]

`--functions` lists what the step enters: per file its functions, how often each is called, and how
often from other files.

A step is the fourth `Pipeline.step` of a warmed pipeline (SIFT, embedded map, matched inline) that
returns a fix and odometry. Crossings are calls whose nearest caller in the package is in another
file. The import chain is the longest path over all imports, those inside functions too.
"""

import ast
import json
import statistics
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "vwnav"
SIMULATED = ("sim", "bench")  # no part of what flies
FRAME_HZ, TELEMETRY_PER_FRAME = 5.0, 10
HEIGHT_M, SPEED_M_S = 50.0, 4.0
WARM_STEPS = 3


@dataclass(frozen=True, slots=True)
class Function:
    """One function: its lines in all, and those that are a docstring or a comment."""

    lines: int
    told: int


@dataclass(frozen=True, slots=True, kw_only=True)
class House:
    """The figures, and where the largest of each stands."""

    step_files: int
    step_functions: int
    step_crossings: int
    import_chain: int
    files_in_a_folder: int
    largest_file: int
    circles: int
    doubled_classes: int
    lines: int
    function_median: float
    function_p90: float
    told_per_function: float
    chain: tuple[str, ...]
    folder: str
    largest: str
    circle: tuple[str, ...]
    doubled: tuple[str, ...]


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(files: dict[str, Path]) -> dict[str, set[str]]:
    """Of each module those of the package that it imports, anywhere in it."""
    found: dict[str, set[str]] = {}
    for name, path in files.items():
        targets: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                targets |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                targets |= (inner & files.keys()) or {node.module}
        found[name] = (targets & files.keys()) - {name, "vwnav"}
    return found


def circles_of(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for target in sorted(graph[node]):
            if target not in index:
                visit(target)
                low[node] = min(low[node], low[target])
            elif target in stack:
                low[node] = min(low[node], index[target])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[-len(group) :]
            if len(group) > 1:
                found.append(group)

    for node in graph:
        if node not in index:
            visit(node)
    return found


def longest_chain(graph: dict[str, set[str]]) -> tuple[str, ...]:
    """Of modules, each importing the next; circles are not gone round."""
    known: dict[str, tuple[str, ...]] = {}

    def below(node: str, above: tuple[str, ...]) -> tuple[str, ...]:
        if node not in known:
            targets = graph[node] - set(above)
            chains = (below(target, (*above, node)) for target in sorted(targets))
            known[node] = (node, *max(chains, key=len, default=()))
        return known[node]

    return max((below(node, ()) for node in graph), key=len)


def functions_of(path: Path) -> Iterator[Function]:
    with tokenize.open(path) as file:
        tokens = tokenize.generate_tokens(file.readline)
        comments = {each.start[0] for each in tokens if each.type == tokenize.COMMENT}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            span = range(node.lineno, node.end_lineno + 1)
            docstring = ast.get_docstring(node, clean=False)
            told = 0 if docstring is None else docstring.count("\n") + 1
            yield Function(len(span), told + sum(line in comments for line in span))


def class_names(files: dict[str, Path]) -> list[str]:
    """Of all classes at top level, a leading underscore ignored."""
    trees = (ast.parse(path.read_text()).body for path in files.values())
    return [n.name.lstrip("_") for body in trees for n in body if isinstance(n, ast.ClassDef)]


class Entered:
    """What a call enters of the package: functions, files, and from file to file."""

    def __init__(self) -> None:
        self.calls: Counter[CodeType] = Counter()
        self.crossed: Counter[CodeType] = Counter()  # calls from another file

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        """A profile function (`sys.setprofile`)."""
        code = frame.f_code
        if event != "call" or not in_package(code):
            return
        self.calls[code] += 1
        caller = frame.f_back
        while caller is not None and not in_package(caller.f_code):
            caller = caller.f_back
        if caller is not None and caller.f_code.co_filename != code.co_filename:
            self.crossed[code] += 1

    @property
    def files(self) -> set[str]:
        return {code.co_filename for code in self.calls}

    def told(self) -> Iterator[str]:
        """A line for each file, the fullest first, then its functions in order of place."""
        of = {file: [c for c in self.calls if c.co_filename == file] for file in self.files}
        for file, codes in sorted(of.items(), key=lambda each: -len(each[1])):
            crossed = sum(self.crossed[code] for code in codes)
            name = Path(file).relative_to(PACKAGE)
            yield f"{name}: {len(codes)} functions, {crossed} calls from other files"
            for code in sorted(codes, key=lambda code: code.co_firstlineno):
                yield f"{self.calls[code]:>6}{self.crossed[code]:>4}  {code.co_qualname}"


def in_package(code: CodeType) -> bool:
    return code.co_filename.startswith(str(PACKAGE))


def one_step() -> Entered:
    """Fly until the step that counts, and listen to it."""
    import numpy as np

    from vwnav.assemble import assemble
    from vwnav.bench.flights.setup import Setup
    from vwnav.bench.flights.world import Place, draw
    from vwnav.config import Config
    from vwnav.estimation.beginning.starts import Start
    from vwnav.geometry.geodesy import LocalFrame
    from vwnav.maps.pack import MapPack
    from vwnav.onboard.simulation import DEFAULT_SITE, map_pack_of
    from vwnav.seams import InlineExecutor
    from vwnav.sim.named_sites import parse_site
    from vwnav.sim.renderer import default_camera
    from vwnav.types import Attitude, Frame, Height, MapFix, OdometryMotion
    from vwnav.vision.features.load import load_features

    sift = load_features("sift")
    site, pack = parse_site(DEFAULT_SITE), map_pack_of(DEFAULT_SITE, [sift])
    camera = default_camera()
    frame = LocalFrame(site.home_lat_deg, site.home_lon_deg, 0.0)
    place, level = np.array([0.0, 0.0, -HEIGHT_M]), np.array([1.0, 0.0, 0.0, 0.0])
    velocity = np.array([SPEED_M_S, 0.0, 0.0])
    with MapPack.open(pack) as opened:
        assembled = assemble(
            sift, None, opened, camera, frame, Config(), InlineExecutor(), lambda _: None
        )
        assembled.ekf.initialise(Start(t_s=0.0, position_ned_m=place, agl_m=HEIGHT_M))
        renderer = draw(Setup(), Place(site, pack, camera, sift, None))
        found = 0
        for number in range(1, 200):
            t_s = number / FRAME_HZ
            for i in range(1, TELEMETRY_PER_FRAME + 1):
                told_s = t_s + (i / TELEMETRY_PER_FRAME - 1.0) / FRAME_HZ
                assembled.pipeline.feed(Attitude(told_s, level))
                assembled.pipeline.feed(Height(told_s, HEIGHT_M))
            image = renderer.render(place + t_s * velocity, np.eye(3), t_s, velocity, np.zeros(3))
            entered = Entered()
            sys.setprofile(entered)
            step = assembled.pipeline.step(Frame(t_s, image, number))
            sys.setprofile(None)
            both = isinstance(step.outcome, MapFix) and isinstance(step.motion, OdometryMotion)
            found += both
            if both and found > WARM_STEPS:
                return entered
    raise RuntimeError("no step had a fix and odometry")


def measure() -> House:
    """All of it."""
    paths = sorted(PACKAGE.rglob("*.py"))
    files = {module_name(path): path for path in paths}
    sizes = {path: len(path.read_text().splitlines()) for path in paths}
    graph = imports(files)
    circles = circles_of(graph)
    flying = [p for p in paths if p.relative_to(PACKAGE).parts[0] not in SIMULATED]
    folder, most = Counter(p.parent for p in flying if p.stem != "__init__").most_common(1)[0]
    largest = max(sizes, key=lambda path: sizes[path])
    doubled = [name for name, n in Counter(class_names(files)).items() if n > 1]
    functions = [each for path in paths for each in functions_of(path)]
    lengths = sorted(each.lines for each in functions)
    entered, chain = one_step(), longest_chain(graph)
    return House(
        step_files=len(entered.files),
        step_functions=len(entered.calls),
        step_crossings=entered.crossed.total(),
        import_chain=len(chain),
        files_in_a_folder=most,
        largest_file=sizes[largest],
        circles=len(circles),
        doubled_classes=len(doubled),
        lines=sum(sizes.values()),
        function_median=statistics.median(lengths),
        function_p90=lengths[int(0.9 * len(lengths))],
        told_per_function=round(sum(each.told for each in functions) / len(functions), 3),
        chain=tuple(name.removeprefix("vwnav.") for name in chain),
        folder=str(folder.relative_to(ROOT)),
        largest=str(largest.relative_to(ROOT)),
        circle=tuple(circles[0]) if circles else (),
        doubled=tuple(sorted(doubled)),
    )


def main() -> None:
    """Print what was measured."""
    if "--functions" in sys.argv[1:]:
        print("\n".join(one_step().told()))
        return
    figures = asdict(measure())
    if "--json" in sys.argv[1:]:
        print(json.dumps(figures))
        return
    for name, value in figures.items():
        told = " ".join(value) if isinstance(value, tuple) else value
        print(f"{name.replace('_', ' '):>20}  {told}")


if __name__ == "__main__":
    main()
