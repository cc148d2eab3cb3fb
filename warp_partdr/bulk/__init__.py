"""People of whole data sets of pictures: found, fitted in batches, and written to Parquet, shard by shard.

``run.make_dataset`` is the entry, ``rows`` has the columns. Pictures are divided into shards by the order of their
names alone (``shards``): a shard's file appears when all of it is there, and a shard that is there is not made again.
``reading`` opens them again: for ``survey``, whose ``page`` shows all rows in numbers and the worst people, and for
``export``, which writes the files of single rows.
"""
