"""Cross checks: what no single value shows. Each problem stands at the line that is to be changed."""

from softplc.config import checks_names, checks_servers, checks_signal, checks_tags, checks_values
from softplc.config.facts import gather
from softplc.config.problem import Problem
from softplc.config.tree import Node


def check(root: Node) -> list[Problem]:
    """Everything wrong between the parts of a configuration; parts that are wrong in themselves are passed over."""
    facts = gather(root)
    return [
        problem
        for checks in (checks_names, checks_values, checks_signal, checks_tags, checks_servers)
        for problem in checks.check(facts)
    ]
