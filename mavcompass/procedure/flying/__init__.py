"""Flying a recording's motion again: the profile that was flown, and a vehicle that follows it."""

from __future__ import annotations

from mavcompass.procedure.flying.follow import fly_profile
from mavcompass.procedure.flying.profile import Profile, profile_of

__all__ = ["Profile", "fly_profile", "profile_of"]
