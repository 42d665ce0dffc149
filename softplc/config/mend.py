"""Mistyped keys and words: the problem to report, and the change to the tree that takes them as they were meant."""

from collections.abc import Callable, Sequence

from softplc.config import words
from softplc.config.problem import Path, Problem
from softplc.config.tree import Mapping, Scalar

Mend = Callable[[], None]


def misspelt_key(
    block: Mapping, key: str, path: Path, known: Sequence[str], home: str | None = None
) -> tuple[Problem, Mend | None]:
    """A key of a block that is none of those known there; `home`: the block beside it that does know it."""
    entry = block.entries[key]
    free = [name for name in known if name not in block.entries]
    if home is not None:
        text = f"unknown key here; it belongs into the block {home}: indent it below {home}:"
        return Problem(entry.line, entry.column, path, text), None
    guess = words.near(key, free)
    text = "unknown key" + (words.did_you_mean(key, free) or f", expected {words.choice(known)}")
    if key.isdecimal() and isinstance(entry.value, Scalar) and entry.value.value is None:
        text += "; numbers have a decimal point, not a comma"
    problem = Problem(entry.line, entry.column, path, text)
    if guess is None or guess[1] < words.SURE:
        return problem, None
    meant = guess[0]

    def mend() -> None:
        if key in block.entries and meant not in block.entries:
            block.entries[meant] = block.entries.pop(key)

    return problem, mend


def misspelt_word(
    node: Scalar, path: Path, known: Sequence[str], in_words: str | None = None
) -> tuple[Problem, Mend | None]:
    """A word that is none of those allowed; `in_words` says what they are where they are too many to be listed."""
    text = f"found {words.found(node)}, expected {in_words or words.choice(known)}"
    if not isinstance(node.value, str):
        return Problem(node.line, node.column, path, text), None
    guess = words.near(node.value, known)
    problem = Problem(node.line, node.column, path, text + words.did_you_mean(node.value, known))
    if guess is None:
        return problem, None
    meant = guess[0]

    def mend() -> None:
        node.value = meant

    return problem, mend
