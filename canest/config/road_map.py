"""The road map that stands beside a config: what the file under its key `road_map` holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canest.road.table import RoadMap


class KeptRoadMap:
    """Kept beside a config, and no part of its content; see `Databases`.

    name: the value of `road_map` that it belongs to. road: None while it has not been read.
    """

    def __init__(self, name: str | None = None, road: RoadMap | None = None) -> None:
        self.name, self.road = name, road

    def __eq__(self, other: object) -> bool:
        return isinstance(other, KeptRoadMap)

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[type[KeptRoadMap], tuple[()]]:
        return KeptRoadMap, ()
