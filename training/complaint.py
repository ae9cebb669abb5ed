"""How a program of training or export ends that cannot go on: one line, no traceback."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_line() -> Iterator[None]:
    """What cannot be read or written ends a program with one line, and so does Ctrl-C.

    Raises:
        SystemExit: in the place of an OSError or a KeyboardInterrupt.
    """
    try:
        yield
    except OSError as error:
        named = error.filename is not None and error.strerror is not None
        raise SystemExit(f"{error.filename}: {error.strerror}" if named else str(error)) from error
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        raise SystemExit(130) from None
