"""Training of the networks.

The loop (``loop``, with ``config``, ``schedule``, ``ema``, ``checkpoints``, ``trees``, ``watch``, ``guards``, ``logs``)
knows its ``task`` by a protocol alone. There are two:

* ``label_task``, ``label_losses``: the label network, on ``people`` made on the fly of ``poses`` (``mocap``), spoilt by
  ``noise``; ``split`` keeps some apart, ``dice`` is where chance comes from.
* ``picture_task``, ``picture_losses``: EllipBodyNet, on ``picture_data`` of data sets, changed by ``augment``, or on
  ``shaded_people``.
"""
