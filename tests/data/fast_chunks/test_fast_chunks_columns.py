import datasets
import numpy as np
import pytest
import torch

from lerobot_act_chunking.data.fast_chunks import columns
from lerobot_act_chunking.data.fast_chunks.columns import Column, numeric_columns

VALUES = np.arange(30, dtype=np.float32).reshape(10, 3)


@pytest.fixture
def pieces() -> Column:
    parts = [VALUES[:4], VALUES[4:5], VALUES[5:]]
    return Column(parts, np.array([0, 4, 5]), torch.float32)


@pytest.mark.parametrize("rows", [[[0, 3], [4, 5], [9, 0]], [[3, 4, 5, 6]], [[5]]])
def test_gathering_from_pieces_equals_gathering_from_one_array(pieces, rows):
    rows = np.array(rows)
    gathered = pieces.gather(rows)
    assert gathered.shape == (*rows.shape, 3)
    assert torch.equal(gathered, torch.from_numpy(VALUES[rows]))


def test_a_row_beyond_the_column_is_an_error_in_both_layouts(pieces):
    whole = Column([VALUES], np.array([0]), torch.float32)
    for column in (pieces, whole):
        with pytest.raises(IndexError, match="out of bounds"):
            column.gather(np.array([10]))


def test_gathered_rows_are_copies():
    stored = VALUES.copy()
    Column([stored], np.array([0]), torch.float32).gather(np.array([2])).zero_()
    np.testing.assert_array_equal(stored, VALUES)


def table(**features: tuple[object, list]) -> datasets.Dataset:
    columns_ = {key: values for key, (_, values) in features.items()}
    types = datasets.Features({key: feature for key, (feature, _) in features.items()})
    return datasets.Dataset.from_dict(columns_, features=types)


def test_only_columns_of_numbers_without_gaps_are_numeric():
    found = numeric_columns(
        table(
            number=(datasets.Value("int16"), [1, 2]),
            gap=(datasets.Value("float32"), [1.0, None]),
            inner_gap=(datasets.List(datasets.Value("float32"), length=2), [[1.0, 2.0], [None, 3.0]]),
            ragged=(datasets.List(datasets.Value("float32")), [[1.0], [2.0, 3.0]]),
            text=(datasets.Value("string"), ["a", "b"]),
            unsigned=(datasets.Value("uint64"), [1, 2]),
            moment=(datasets.Value("timestamp[s]"), [0, 1]),
            varying=(datasets.Array2D(shape=(None, 2), dtype="float32"), [[[1.0, 2.0]], [[3.0, 4.0]]]),
        )
    )
    assert list(found) == ["number"]


@pytest.mark.parametrize(
    ("stored", "expected"),
    [("bool", torch.bool), ("uint8", torch.int64), ("int32", torch.int64), ("float64", torch.float32)],
)
def test_types_are_those_of_torch_tensor_of_python_numbers(stored, expected):
    values = [[0, 1], [1, 1]]
    (column,) = numeric_columns(table(x=(datasets.List(datasets.Value(stored), length=2), values))).values()
    gathered = column.gather(np.array([1]))
    assert gathered.dtype == expected
    assert gathered.tolist() == [[1, 1]]
    assert column.pieces[0].dtype == stored  # kept small in memory, widened when gathered


def test_an_index_mapping_of_the_table_is_respected():
    (column,) = numeric_columns(table(x=(datasets.Value("int64"), [10, 11, 12])).select([2, 0])).values()
    assert column.gather(np.array([0, 1])).tolist() == [12, 10]


def test_small_tables_are_joined_and_large_ones_stay_in_pieces(monkeypatch):
    part = table(x=(datasets.Value("float32"), [1.0, 2.0]))
    both = datasets.concatenate_datasets([part, part])
    assert len(numeric_columns(both)["x"].pieces) == 1
    monkeypatch.setattr(columns, "JOIN_LIMIT_BYTES", 15)
    assert len(numeric_columns(both)["x"].pieces) == 2
