"""What everything stands on: devices, batches, results on disk, commands, bad input."""
