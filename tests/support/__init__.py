"""What several tests share: hand-made tag tables and exchanges, peers, ports, polling."""
