"""Which numbers are masses of vehicles."""

from __future__ import annotations

#: no vehicle weighs less; a smaller number is a mass in tonnes
LEAST_MASS_KG = 50
