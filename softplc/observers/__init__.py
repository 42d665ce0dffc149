"""One file for each observer type: config model, tags, one call into the kernel."""
