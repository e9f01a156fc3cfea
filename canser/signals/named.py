"""Signals by their names, for classes that hold several; and names that there are not."""

import difflib
from collections.abc import Callable, ItemsView, Iterable, Iterator, KeysView, Mapping, ValuesView
from typing import Any

from canser.signals.signal import Signal

__all__ = ["Made", "Named", "unknown_name"]


class Made(Mapping[str, Signal]):
    """Signals that are made when they are first asked for: most of many signals never are.

    `places`: what `make` takes to make the signal of each name.
    """

    def __init__(self, places: Mapping[str, Any], make: Callable[[Any], Signal]) -> None:
        self._places, self._make = places, make
        self._made: dict[str, Signal] = {}

    def __getitem__(self, name: str) -> Signal:
        made = self._made.get(name)
        if made is None:
            made = self._made.setdefault(name, self._make(self._places[name]))
        return made

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


class Named:
    """Signals by full names, or by the end of a name that only one has.

    It has the methods of a mapping, and is none for `isinstance`: polars looks for columns in a
    mapping, and not for Arrow's capsules.
    """

    def __init__(self, signals: Mapping[str, Signal]) -> None:
        self._signals = signals

    def __getitem__(self, name: str) -> Signal:
        if name in self._signals:
            return self._signals[name]
        found = [each for each in self._signals if each.rpartition(".")[2] == name]
        if len(found) == 1:
            return self._signals[found[0]]
        if found:
            raise KeyError(f"{name!r} is in several messages: {', '.join(found)}")
        raise KeyError(self._absent(name))

    def __iter__(self) -> Iterator[str]:
        return iter(self._signals)

    def __len__(self) -> int:
        return len(self._signals)

    def __contains__(self, name: object) -> bool:
        try:
            self[name]  # type: ignore[index]
        except (KeyError, TypeError):
            return False
        return True

    def get(self, name: str, default: Any = None) -> Any:
        """Return a signal, or `default` if there is none of this name.

        Parameters
        ----------
        name : str
            The full name, or the end of it that only one has.
        default : object
            What is returned if there is none. None by default.

        Returns
        -------
        Signal
            The signal, or `default`.
        """
        try:
            return self[name]
        except KeyError:
            return default

    def keys(self) -> KeysView[str]:
        """Return the names.

        Returns
        -------
        collections.abc.KeysView of str
            "Message.Signal"; in a group "Signal".
        """
        return self._signals.keys()

    def values(self) -> ValuesView[Signal]:
        """Return the signals.

        Returns
        -------
        collections.abc.ValuesView of Signal
            In the order of the names.
        """
        return self._signals.values()

    def items(self) -> ItemsView[str, Signal]:
        """Return names and signals.

        Returns
        -------
        collections.abc.ItemsView
            Pairs of a name and its signal.
        """
        return self._signals.items()

    def _absent(self, name: str) -> str:
        """Return why there is no such signal."""
        have = ", ".join(list(self._signals)[:8]) or "none"
        more = f" and {len(self) - 8:,} more" if len(self) > 8 else ""
        return f"there is no signal {name!r}; there are: {have}{more}"


def unknown_name(name: str, what: str, names: Iterable[str]) -> str:
    """Return that the database has no such name, with those that are like it."""
    names = list(names)
    alike = difflib.get_close_matches(name, [*names, *(each.rpartition(".")[2] for each in names)])
    hint = f"; did you mean {' or '.join(dict.fromkeys(alike))}?" if alike else ""
    return f"the database has no {what} {name!r}{hint}"
