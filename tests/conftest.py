"""Settings of all tests."""

from hypothesis import settings

# Laws are about values, not about how busy the machine is.
settings.register_profile("any_machine", deadline=None)
settings.load_profile("any_machine")
