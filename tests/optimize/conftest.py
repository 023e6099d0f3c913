"""Examples are judged by what they show, not by how long a busy machine takes over one."""

from hypothesis import settings

settings.register_profile("no-deadline", deadline=None)
settings.load_profile("no-deadline")
