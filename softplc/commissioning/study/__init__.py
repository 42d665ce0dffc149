"""The experiments of the papers behind the observers, run anew and written down as a report."""
