"""STATUSTEXT of the autopilot, put together where a long text came in chunks."""

from collections import deque
from collections.abc import Mapping
from typing import Any

_CHUNK_CHARACTERS = 50
_KEEP = 50
_LOST = "..."
_WARNING = 4  # MAV_SEVERITY: smaller is worse


class StatusTexts:
    """The newest texts, with the time of their arrival."""

    def __init__(self) -> None:
        self._texts: deque[tuple[float, int, str]] = deque(maxlen=_KEEP)
        self._chunks: dict[int, list[str]] = {}

    def handle(self, fields: Mapping[str, Any], received_s: float) -> str | None:
        """Take one message in; the whole text when it is complete, None otherwise."""
        part, number = fields["text"], fields.get("id", 0)
        if number:
            chunks = self._chunks.setdefault(number, [])
            sequence = fields.get("chunk_seq", 0)
            del chunks[sequence:]  # a number that is used again begins anew
            if sequence > len(chunks):
                chunks.append(_LOST)
            chunks.append(part)
            while len(self._chunks) > _KEEP:
                del self._chunks[next(iter(self._chunks))]
            if len(part) >= _CHUNK_CHARACTERS:
                return None
            part = "".join(self._chunks.pop(number))
        text = " ".join(part.split())
        if not text:  # PX4 sends empty ones
            return None
        self._texts.append((received_s, fields["severity"], text))
        return text

    def warnings_since(self, t_s: float) -> list[str]:
        """Texts of warning severity or worse that came after `t_s`, oldest first, each once."""
        found = (text for at, severity, text in self._texts if at >= t_s and severity <= _WARNING)
        return list(dict.fromkeys(found))
