"""The observers as scalars, one function for each function block: the specification, slow and readable."""
