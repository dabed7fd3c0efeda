"""Lets the tests in the folders below import the helper that stands here: bent_vehicles."""

from __future__ import annotations

from wakes import no_script_spins as no_script_spins
