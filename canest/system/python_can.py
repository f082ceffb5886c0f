"""python-can without what it imports for formats that nobody asked for.

Where asammdf is installed, python-can imports it for its log formats: a second and 80 MB. Hidden while
python-can is imported for the first time, it is not found, which python-can accepts. A log that wants it
calls `canest.logs.damaged.find_asammdf`.
"""

from __future__ import annotations

import sys

__all__ = ["can"]

_HIDDEN = "can" not in sys.modules and "asammdf" not in sys.modules
if _HIDDEN:
    sys.modules["asammdf"] = None  # type: ignore[assignment]
try:
    import can
finally:
    if _HIDDEN:
        del sys.modules["asammdf"]
