"""People of known truth: their poses, bodies, pictures and the noise of what is seen of them.

* ``population``: statures, girths, limbs and ages of people, as shapes of Anny.
* ``people``: phenotypes, Anny in a pose, before a camera, drawn, and what is hidden of it.
* ``poses``: the mean body, limbs in the way, the pose prior; ``pose_recipes`` (PartBench), ``procedural_poses``,
  ``touching_poses`` and ``pose_sampler`` (training), ``mocap`` and ``mocap_files``.
* ``noise``: PartBench's; ``keypoint_noise``, ``label_noise`` and ``occluders``: training's, in batches;
  ``detector_errors``: the packaged detector's.
* ``shading``: pictures. ``partbench_people``, ``training_people``, ``shaded`` (samples with pictures) and
  ``tradeoff_people`` put all together.
* ``photo_people``: pictures that look like photos, in batches, from ``photo_surfaces``, ``photo_colours``,
  ``photo_light``, ``photo_effects`` and ``backdrops``.
* ``rng``: random numbers on a device.
"""
