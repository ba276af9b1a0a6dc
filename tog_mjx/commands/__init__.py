"""The command line, one module a command: `run()` takes its arguments from `sys.argv`. `tog_mjx.__main__` calls it."""
