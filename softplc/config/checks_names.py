"""Names: each once, none reserved, and every reference leads somewhere; a source belongs to one task."""

from collections.abc import Iterable, Iterator
from typing import Final

from softplc.config import words
from softplc.config.facts import Facts, Item
from softplc.config.models import Task
from softplc.config.problem import Path, Problem, shown
from softplc.config.tree import Mapping, Node, below, items_at, text_at, where

RESERVED: Final = ("Tasks", "Sources")  # their tags stand beside the axes in the address space
DEFAULT_TASK: Final[str] = Task.model_fields["name"].default


def check(facts: Facts) -> Iterator[Problem]:
    """All problems with names."""
    for what, items in (("task", facts.tasks), ("source", facts.sources), ("axis", facts.axes)):
        yield from _twice(what, items)
    for publisher in facts.publishers:
        users = [
            Item((*publisher.path, *path), block, text_at(block, "name"))
            for path, block in items_at(publisher.block, "users")
            if isinstance(block, Mapping)
        ]
        yield from _twice("user", users)
    yield from _reserved(facts.axes)
    yield from _references(facts)
    yield from _split_sources(facts)


def at(node: Node | None, otherwise: Node) -> tuple[int, int]:
    """Line and column of a node, or of another when it is not there."""
    node = node or otherwise
    return node.line, node.column


def place(item: Item) -> tuple[int, int]:
    """Line and column of an entry's name."""
    return at(below(item.block, "name"), item.block)


def task_names(facts: Facts) -> list[str | None]:
    """Name of every task; one that does not say is called main."""
    named = [task.name if "name" in task.block.entries else DEFAULT_TASK for task in facts.tasks]
    return named or [DEFAULT_TASK]


def named_at(item: Item) -> str:
    """Where an entry's name stands, in words."""
    return where(below(item.block, "name") or item.block)


def _twice(what: str, items: Iterable[Item]) -> Iterator[Problem]:
    first: dict[str, Item] = {}
    for item in items:
        name = item.name
        if name is None:
            if what != "task" or "name" in item.block.entries:
                continue
            name = DEFAULT_TASK
        same = first.setdefault(name.casefold() if what == "axis" else name, item)
        if same is item:
            continue
        node = below(item.block, "name")
        if node is not None and node is below(same.block, "name") and item.block.line == same.block.line:
            text = f"every instance is called {shown(name)}, expected a placeholder in it, as in {shown(name)}{{n}}"
        elif same.name in (name, None):
            text = (
                f"found a second {what} {shown(name)} (the first is in {named_at(same)}), expected a name of its own"
            )
        else:
            text = (
                f"found {shown(name)}, which differs from the axis {shown(str(same.name))} in {named_at(same)} "
                "in case alone, expected a name that cannot be confused with it"
            )
        yield Problem(*place(item), (*item.path, "name"), text)


def _reserved(axes: Iterable[Item]) -> Iterator[Problem]:
    for axis in axes:
        for name in RESERVED:
            if axis.name is not None and axis.name.casefold() == name.casefold():
                text = f"found {axis.name}, expected another name: {name} holds the tags of all {name.lower()}"
                yield Problem(*place(axis), (*axis.path, "name"), text)


def _references(facts: Facts) -> Iterator[Problem]:
    if "sources" not in facts.unknown:
        known = [source.name for source in facts.sources if source.name is not None]
        used = [(tag.block, tag.path, tag.source) for tag in facts.tags]
        nameless = len(facts.sources) - len(known)
        yield from _unknown("source", used, known, nameless)
    if "tasks" not in facts.unknown:
        tasks = task_names(facts)
        wanted = [(axis.block, axis.path, axis.text("task")) for axis in facts.axes]
        known = [name for name in tasks if name is not None]
        yield from _unknown("task", wanted, known, len(tasks) - len(known))
    if "axes" not in facts.unknown:
        known = [axis.name for axis in facts.axes if axis.name is not None]
        placed = [
            (block, (*publisher.path, *path), text_at(block, "axis"))
            for publisher in facts.publishers
            for path, block in items_at(publisher.block, "placements")
            if isinstance(block, Mapping)
        ]
        yield from _unknown("axis", placed, known, len(facts.axes) - len(known))


def _unknown(
    key: str, used: Iterable[tuple[Mapping, Path, str | None]], known: list[str], nameless: int
) -> Iterator[Problem]:
    """References to no entry. Entries without a readable name may be what is meant: then nothing is said."""
    names = set(known)
    wrong = [(block, path, name) for block, path, name in used if name is not None and name not in names]
    if len({name for _, _, name in wrong}) <= nameless:
        return
    for block, path, name in wrong:
        listed = words.did_you_mean(name, known) or (f", expected {words.choice(known)}" if known else "")
        yield Problem(*at(below(block, key), block), (*path, key), f"there is no {key} {shown(name)}{listed}")


def _split_sources(facts: Facts) -> Iterator[Problem]:
    """A source that axes of two tasks use: reported where the second task does so first."""
    tasks = task_names(facts)
    if "tasks" in facts.unknown:
        return
    owner: dict[str, tuple[str, Item]] = {}
    said: set[tuple[str, str]] = set()
    for tag in facts.tags:
        task = tag.axis.text("task") if "task" in tag.axis.block.entries else tasks[0]
        source = tag.source
        if task not in tasks or task is None or source is None:
            continue
        first, axis = owner.setdefault(source, (task, tag.axis))
        if first != task and (source, task) not in said:
            said.add((source, task))
            text = (
                f"found {shown(source)} in task {shown(task)}, but task {shown(first)} reads it already "
                f"(axis {shown(axis.name or '')}, {named_at(axis)}), expected one task for a source; "
                "declare the source a second time under another name"
            )
            yield Problem(*at(below(tag.block, "source"), tag.block), (*tag.path, "source"), text)
