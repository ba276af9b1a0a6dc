"""What everything stands on: devices, batches, results on disk, scripts, bad input."""
