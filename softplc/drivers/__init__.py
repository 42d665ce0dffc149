"""One file or folder for each protocol that softplc reads from: config model, driver, pure codec."""
