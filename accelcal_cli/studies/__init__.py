"""A folder of recordings, in parallel and resumable: found, shared out to workers, summed up."""
