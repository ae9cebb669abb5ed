"""Numbers as messages carry them: whole ones, of limited size."""


def int16(value: float) -> int:
    """The nearest that 16 bits hold."""
    return max(-32768, min(32767, round(value)))


def cm_s(speed_m_s: float) -> int:
    """A speed in centimetres a second, 16 bits."""
    return int16(100.0 * speed_m_s)


def mm(height_m: float) -> int:
    """A height in millimetres, 32 bits."""
    return max(-(2**31), min(2**31 - 1, round(1000.0 * height_m)))


def ms(t_s: float) -> int:
    """A time in milliseconds."""
    return int(1000.0 * t_s)


def us(t_s: float) -> int:
    """A time in microseconds."""
    return int(1e6 * t_s)
