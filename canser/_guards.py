"""Guards against misuse: a dict that cannot be changed, and objects that cannot be copied."""

from collections.abc import Callable
from typing import Any, Never, TypeVar

__all__ = ["ReadOnlyDict", "Uncopied"]

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


def _refuse(*_: object, **__: object) -> Never:
    raise TypeError("this dict cannot be changed; dict(...) makes a copy that can")


class ReadOnlyDict(dict[_Key, _Value]):
    """A dict that cannot be changed. It can be compared, copied and pickled, and goes into JSON."""

    __slots__ = ()

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[dict[_Key, _Value]]]:
        return type(self), (dict(self),)


class Uncopied:
    """Base class of objects that stand for one stream, file or line.

    Otherwise `copy.copy` would make a second object for the same stream. Each would miss what the
    other takes, and their locks would not exclude each other.
    """

    __slots__ = ()

    def __reduce_ex__(self, _: object) -> Never:
        name = type(self).__name__
        raise TypeError(
            f"a {name} cannot be copied or pickled: the copy would share its state; make another"
        )
