"""Workers that are processes: of this machine, or of a dask.distributed cluster."""
