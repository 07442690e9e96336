"""The one error a user meets."""


class IdimError(Exception):
    """Input that idim refuses.

    The message is one sentence for a person: what is wrong, where (file, key, joint, time), and
    what to do about it.
    """
