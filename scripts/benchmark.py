from tog_mjx.__main__ import run

run("benchmark")
