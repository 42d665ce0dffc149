"""One file or folder for each way that softplc serves its tags."""
