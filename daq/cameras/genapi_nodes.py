"""A GenApi node map (of the genicam package) as `cameras.sfnc.Nodes`."""

from typing import Any

from genicam import genapi

from daq.cameras.camera import Setting
from daq.errors import SettingRefused


class GenApiNodes:
    """A node map as `Nodes`."""

    def __init__(self, node_map: Any) -> None:  # noqa: ANN401 - genicam has no types
        self._map = node_map

    def names(self) -> list[str]:
        """Every feature below Root that has a value."""
        with_value = {genapi.EInterfaceType.intfIInteger, genapi.EInterfaceType.intfIFloat}
        with_value |= {genapi.EInterfaceType.intfIBoolean, genapi.EInterfaceType.intfIString}
        with_value.add(genapi.EInterfaceType.intfIEnumeration)
        return [
            entry.node.name
            for entry in self._map.nodes
            if entry.node.is_feature() and entry.node.principal_interface_type in with_value
        ]

    def has(self, name: str) -> bool:
        """Whether the feature exists and can be read or written now."""
        if not self._map.has_node(name):
            return False
        return self._map.get_node(name).get_access_mode() in (genapi.EAccessMode.RO, genapi.EAccessMode.RW)

    def get(self, name: str) -> Setting:
        """Value of a feature, past the cache."""
        feature = self._map.get_node(name)
        for node in (feature.node, *(child.node for child in feature.node.children)):
            node.invalidate_node()
        value = feature.value
        return value if isinstance(value, bool | int | float | str) else str(value)

    def set(self, name: str, value: Setting) -> None:
        """Write a feature; SettingRefused with the limits if it does not take the value."""
        feature = self._map.get_node(name)
        try:
            feature.value = value
        except (genapi.GenericException, TypeError, OverflowError) as error:
            raise SettingRefused(
                f"{name} = {value!r} is refused{self._limits(feature)}: {one_line(error)}"
            ) from error

    def entries(self, name: str) -> tuple[str, ...]:
        """Entries of an enumeration."""
        return tuple(self._map.get_node(name).symbolics)

    def can_execute(self, name: str) -> bool:
        """Whether the command exists and is available now."""
        if not self._map.has_node(name):
            return False
        return self._map.get_node(name).get_access_mode() in (genapi.EAccessMode.WO, genapi.EAccessMode.RW)

    def execute(self, name: str) -> None:
        """Execute a command."""
        self._map.get_node(name).execute()

    def _limits(self, feature: Any) -> str:  # noqa: ANN401
        try:
            if hasattr(feature, "symbolics"):
                return f" (one of {', '.join(feature.symbolics)})"
            return f" (from {feature.min} to {feature.max})"
        except (AttributeError, genapi.GenericException):
            return ""


def one_line(error: BaseException) -> str:
    """Text of an error of the library, which likes several lines."""
    return " ".join(str(error).split())[:300] or type(error).__name__
