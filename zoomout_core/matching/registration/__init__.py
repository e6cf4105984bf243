"""The target bent onto the source, limb by limb."""
