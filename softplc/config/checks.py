"""Cross checks: what no single value shows. Each problem stands at the line that is to be changed."""

from pathlib import Path

from softplc.config import checks_names, checks_servers, checks_signal, checks_tags, checks_values
from softplc.config.facts import gather
from softplc.config.problem import Problem
from softplc.config.tree import Node


def check(root: Node, folder: Path) -> list[Problem]:
    """Everything wrong between the parts of a configuration, and with the files that it names as seen from `folder`.

    Parts that are wrong in themselves are passed over.
    """
    facts = gather(root, folder)
    return [
        problem
        for checks in (checks_names, checks_values, checks_signal, checks_tags, checks_servers)
        for problem in checks.check(facts)
    ]
