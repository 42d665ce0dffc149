"""Set-up: dev.py, the locks, the container image, the systemd unit, the documents that belong to them."""
