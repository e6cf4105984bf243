"""Attribute transfer for pymeshlab: between layers in different poses, or of different triangles.

    import pymeshlab
    import meshlab_filter

    ms = pymeshlab.MeshSet()
    ms.load_new_mesh("character.obj")    # mesh 0, with textures
    ms.load_new_mesh("retopology.ply")   # mesh 1, in another pose
    meshlab_filter.transfer_attributes(ms, sourcemesh=0, targetmesh=1)
    ms.save_current_mesh("result.obj")

`python -m meshlab_filter` does the same for files.
"""

from meshlab_filter.filters import transfer_attributes, transfer_attributes_steps

__all__ = ["transfer_attributes", "transfer_attributes_steps"]
