"""YAML text to a tree with positions, as far as it can be read. The only module that knows ruamel.

Safe from hostile files: no tag makes an object; depth, number of values and length of tags are bounded.
"""

import re
from dataclasses import dataclass
from typing import Any, Final

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)

from softplc.config.compose import Composer
from softplc.config.problem import Problem
from softplc.config.syntax_words import Quote, syntax_problems
from softplc.config.tree import Node

# What the YAML library raises on some texts instead of an error of its own; NotImplementedError is one of them.
_LIBRARY_GAVE_UP: Final = (ValueError, TypeError, LookupError, AttributeError, AssertionError, NotImplementedError)
_LONGEST_TAG: Final = 1000  # the library takes quadratic time for a tag
_LONG_TAG: Final = re.compile(rf"!\S{{{_LONGEST_TAG}}}")


@dataclass(slots=True)
class Document:
    """What a YAML text holds: the tree (None: nothing) and the problems found on the way.

    `broken`: the text could not be read to its end; the tree holds what came before.
    """

    root: Node | None
    problems: list[Problem]
    broken: bool = False


def read(text: str) -> Document:
    """The first document of a YAML text, as far as it can be read."""
    tag = _LONG_TAG.search(text)
    if tag is not None:
        line = text.count("\n", 0, tag.start()) + 1
        column = tag.start() - text.rfind("\n", 0, tag.start())
        words = f"found ! and more than {_LONGEST_TAG} characters without a blank, expected no YAML tag"
        return Document(None, [Problem(line, column, (), words)], broken=True)
    composer = Composer()
    complete = _compose(text, composer)
    return Document(composer.finish(complete=complete), composer.problems, not complete)


def _compose(text: str, composer: Composer) -> bool:
    """Feed the parser's events to the composer; whether the text was read to its end."""
    documents = 0
    quote: Quote | None = None
    try:
        for event in YAML(typ="safe", pure=True).parse(text):
            composer.position = (event.start_mark.line + 1, event.start_mark.column + 1)
            if isinstance(event, DocumentStartEvent):
                documents += 1
                if documents > 1:
                    composer.say("a second document starts here, expected one document in a file")
                    return False
            elif not _take(event, composer):
                return False
            quote = _long_quote(event) or quote
    except MarkedYAMLError as error:
        composer.problems.extend(syntax_problems(error, text, composer.open_since, quote))
        return False
    except (YAMLError, *_LIBRARY_GAVE_UP):
        composer.say("what follows cannot be read as YAML", ())
        return False
    return True


def _take(event: Event, composer: Composer) -> bool:
    """Hand one event over; False when nothing more is to be read."""
    if isinstance(event, ScalarEvent):
        values: Any = event
        return composer.scalar(values.value, values.tag, values.anchor, quoted=not values.implicit[0])
    if isinstance(event, AliasEvent):
        composer.alias(str(event.anchor))
    elif isinstance(event, MappingStartEvent | SequenceStartEvent):
        return composer.open(event.tag, event.anchor, mapping=isinstance(event, MappingStartEvent))
    elif isinstance(event, MappingEndEvent | SequenceEndEvent):
        composer.close()
    return True


def _long_quote(event: Any) -> Quote | None:
    """Where a quoted text over several lines opens and ends; None for anything else."""
    start, end = event.start_mark, event.end_mark
    if not isinstance(event, ScalarEvent) or event.style not in ("'", '"') or start.line == end.line:
        return None
    return Quote(start.line + 1, start.column + 1, end.line + 1)
