"""A batch that is gathered whole and, where possible, collated whole.

Taking a batch of 64 items apart, to stack them again, makes 600 small tensors and costs several times as much
as gathering them. torch's ``default_collate`` lets a type of item be collated by a function of its own (as
its docstring shows); here that is ``GatheredItem``.
"""

from collections.abc import Callable, Sequence
from typing import Any, SupportsIndex, cast, overload

from torch import Tensor
from torch.utils.data._utils.collate import collate, default_collate_fn_map

Item = dict[str, Any]


class GatheredItem(dict[str, Any]):
    """An item of a ``GatheredBatch``: a dictionary, of a type that torch's collation knows."""


class GatheredBatch(Sequence):
    """The items of a batch, each made when it is asked for.

    ``columns`` holds the values of all items by key: a tensor (B, ...) or a list of length B. The tensors of
    an item are views of these; no two items share numbers.
    """

    def __init__(self, columns: dict[str, Tensor | list[Any]]):
        self.columns = columns
        self._items: dict[int, GatheredItem] = {}
        self._first: dict[str, Any] = {}

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    @overload
    def __getitem__(self, index: SupportsIndex) -> GatheredItem: ...
    @overload
    def __getitem__(self, index: slice) -> list[GatheredItem]: ...
    def __getitem__(self, index: SupportsIndex | slice) -> GatheredItem | list[GatheredItem]:
        position = range(len(self))[index]
        if isinstance(position, range):
            return [self[each] for each in position]
        if position not in self._items:
            item = GatheredItem({key: column[position] for key, column in self.columns.items()})
            self._items[position] = item
            if position == 0:
                self._first = dict(item)
        return self._items[position]

    @property
    def untouched(self) -> bool:
        """Whether nobody can have altered an item: at most the first was handed out, and it is as it was.

        torch looks at the first item to learn its type. Numbers written into a tensor of it are in
        ``columns``.
        """
        first = self._items.get(0, self._first)
        same = all(first.get(key) is value for key, value in self._first.items())
        return same and len(first) == len(self._first) and self._items.keys() <= {0}


def _collate(
    batch: GatheredBatch | list[GatheredItem], *, collate_fn_map: dict[Any, Callable] | None = None
) -> Item:
    """What ``default_collate`` makes of a list of dictionaries."""
    if isinstance(batch, list) or not batch.untouched:
        return cast("Item", collate([dict(item) for item in batch], collate_fn_map=collate_fn_map))
    return {
        key: column if isinstance(column, Tensor) else collate(column, collate_fn_map=collate_fn_map)
        for key, column in batch.columns.items()
    }


default_collate_fn_map[GatheredItem] = _collate
