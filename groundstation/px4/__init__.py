"""Direct access to PX4 without the agents: parameters, versions, state, logs and signing keys.

``covey px4`` and ``covey log fetch`` come from here.
"""
