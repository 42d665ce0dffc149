"""The vectors of compiled Structured Text, through the reference and the batch."""

from pathlib import Path

import numpy as np
import pytest

from tests.kernel.sequences import assert_same, read_vector, run_batch, run_reference, ulps, vector_files

FILES = [
    pytest.param(path, precision, id=path.stem) for precision in ("real", "lreal") for path in vector_files(precision)
]


def test_there_are_eleven_sequences_in_each_precision():
    assert [len(vector_files(precision)) for precision in ("real", "lreal")] == [11, 11]


@pytest.mark.parametrize(("path", "precision"), FILES)
def test_reference_gives_every_number_of_the_compiled_structured_text(path: Path, precision: str):
    inputs, expected = read_vector(path)

    outputs, _ = run_reference(inputs, precision)

    assert_same(outputs, expected)


@pytest.mark.parametrize(("path", "precision"), FILES)
def test_batch_of_one_gives_every_number_of_the_compiled_structured_text(path: Path, precision: str):
    inputs, expected = read_vector(path)

    (outputs,), _ = run_batch([inputs], precision)

    assert_same(outputs, expected)
    assert ulps(outputs, expected, precision) == 0


@pytest.mark.parametrize("precision", ["real", "lreal"])
def test_all_sequences_side_by_side_in_one_batch_do_not_disturb_each_other(precision: str):
    vectors = [read_vector(path) for path in vector_files(precision)]

    outputs, _ = run_batch([inputs for inputs, _ in vectors], precision)

    for got, (_, expected) in zip(outputs, vectors, strict=True):
        assert_same(got, expected)


def test_distance_in_ulps_counts_neighbouring_numbers():
    one = np.array([1.0, -1.0, 0.0, np.nan])
    assert ulps(one, np.array([np.nextafter(np.nextafter(1.0, 2), 2), -1.0, -0.0, np.nan]), "lreal") == 2
    assert ulps(one, np.array([1.0, -1.0, np.nextafter(np.nextafter(0, -1), -1), np.nan]), "lreal") == 2
    assert ulps(one, np.array([1.0, np.nextafter(np.float32(-1), np.float32(0)), 0.0, np.nan]), "real") == 1
