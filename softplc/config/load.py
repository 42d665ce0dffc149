"""Read a configuration file: the model, or every error of the file at once.

```
softplc.yaml:9:7: axes[0].observer.q_xdot: unknown key; did you mean q_x_dot?
softplc.yaml:10:12: axes[0].observer.r_x: found -4, expected a number greater than 0 mm²
```
"""

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel

from softplc.config import checks, syntax, words
from softplc.config.expand import expand
from softplc.config.mistaken import mistaken
from softplc.config.models import Config
from softplc.config.problem import Problem, report
from softplc.config.schema import schema
from softplc.config.source_text import read_text
from softplc.config.validate import validate
from softplc.errors import ConfigError

M = TypeVar("M", bound=BaseModel)


def load(path: Path | str) -> Config:
    """The configuration in a file. Raises ConfigError with one line for each error, in the order of the file."""
    return load_model(path, Config)


def load_model(path: Path | str, model: type[M]) -> M:
    """A file as a model, with the same checks of form; a Config is cross-checked as well. Raises ConfigError."""
    text, problems = read_text(Path(path))
    made = None
    if text is not None:
        document = syntax.read(text)
        problems += document.problems
        other_kind = document.root and mistaken(document.root, model)
        if other_kind:
            problems = [other_kind]
        elif document.root is not None:
            expansion = expand(document.root, Path(path).parent)
            made, wrong = validate(document.root, model, expansion)
            if issubclass(model, Config):
                wrong += checks.check(document.root, Path(path).parent)
            problems += expansion.located(document.root, wrong)
        elif not document.broken:
            wanted = words.expected(schema(model), schema(model))
            problems.append(Problem(1, 1, (), f"the file is empty, expected {wanted}"))
    if problems or made is None:
        raise ConfigError(*report(problems, str(path)))
    return made
