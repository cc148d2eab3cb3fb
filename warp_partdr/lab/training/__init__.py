"""Training of the networks.

The loop (``loop``, with ``config``, ``checkpoints``, ``guards``, ``logs``) knows its ``task`` by an interface
alone. There are three:

* ``label_task``: the label network, on people made on the fly (``lab.synthetic.training_people``).
* ``part_task``: the part head, on pictures that look like photos (``lab.synthetic.photo_people``).
* ``picture_task``, ``picture_losses``: EllipBodyNet, on ``picture_data`` of data sets, changed by ``augment``, or on
  shaded people (``lab.synthetic.shaded``).
"""
