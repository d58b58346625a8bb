"""Contact between a surgical instrument and soft tissue, as a model and as an FMI 2.0 co-simulation FMU.

One way through: a scene file becomes a validated ``Scene`` (`scene`), flat arrays (`assemble`), and a ``step``
(`kernels`) that Python (`simulate`) and the FMU (`fmu`) both run.
"""

__version__ = "0.1.0"
