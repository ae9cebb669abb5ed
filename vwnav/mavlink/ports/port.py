"""What the driver of an autopilot needs of a MAVLink connection."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

Fields = Mapping[str, Any]
Handler = Callable[[str, Fields, float], None]
Sender = tuple[int, int]  # system and component
Listener = Callable[[Fields, Sender], None]
Send = Callable[[str, Fields], None]


class Port(Protocol):
    """A connection to one autopilot, for single messages.

    Fields are those of MAVLink's definitions by name: NaN is None, characters are a string, arrays
    are lists.
    """

    @property
    def system_id(self) -> int:
        """Of the autopilot; 0 while none has been heard.

        Whatever is meant for it has to say so: PX4 takes commands, parameters and the origin for
        its own id only, and ignores the broadcast one, 0.
        """
        ...

    @property
    def strangers(self) -> tuple[int, ...]:
        """Systems of other autopilots on the link, where nobody has said which one is ours."""
        ...

    def subscribe(self, name: str, handler: Handler) -> None:
        """Hand every message `name` of the autopilot to `handler`, with the time of arrival."""
        ...

    @property
    def own_id(self) -> Sender:
        """System and component that we are."""
        ...

    def listen(self, name: str, listener: Listener) -> None:
        """Hand every message `name` of whoever else is on the link to `listener`."""
        ...

    def is_for_us(self, fields: Fields) -> bool:
        """Whether a message that has a target is ours; others speak with the autopilot too."""
        ...

    def send(self, name: str, fields: Fields) -> None:
        """Send one message; a link that is down or closed loses it, as the air would.

        Raises:
            ValueError: there is no such message or field.
        """
        ...

    def close(self) -> None:
        """Give the link back."""
        ...
