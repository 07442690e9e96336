"""Effects that a model or its description may lack: one file each, estimated together by one mixed model."""
