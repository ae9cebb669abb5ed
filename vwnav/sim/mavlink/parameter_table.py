"""The parameters of a simulated autopilot, by name."""

from collections.abc import Iterable, Mapping

from vwnav.errors import ConfigError


class SimulatedParameters:
    """Values by name, integers too as numbers.

    Args:
        defaults: (MAV_PARAM_TYPE, value) by name.
        overrides: other values.

    Attributes:
        names: in the order of their indices.

    Raises:
        ConfigError: there is no such parameter.
    """

    def __init__(
        self,
        defaults: Mapping[str, tuple[int, float]],
        overrides: Iterable[tuple[str, float]],
    ) -> None:
        self._types = {name: kind for name, (kind, _) in defaults.items()}
        self._values = {name: value for name, (_, value) in defaults.items()}
        self.names = tuple(self._values)
        for name, value in overrides:
            if name not in self._values:
                raise ConfigError(f"simulated vehicle: no parameter {name}")
            self._values[name] = value

    def __getitem__(self, name: str) -> float:
        """The value."""
        return self._values[name]

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __len__(self) -> int:
        return len(self.names)

    def type_of(self, name: str) -> int:
        """MAV_PARAM_TYPE."""
        return self._types[name]
