"""Many drives in folders: found, analysed by several processes, journalled, and written as one table."""
