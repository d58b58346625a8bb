"""Where each quantity lies in the vectors of parameters, inputs and outputs.

Parameters: `TISSUE_PARAMETERS` for each tissue, then `CONTACT_PARAMETERS` for each contact pair. Inputs: a pose for
each instrument. Outputs: `INSTRUMENT_OUTPUTS` for each instrument, then the energies, the solver's counters and three
coordinates for each probe.
"""

# parameters of one tissue
STIFFNESS_SCALE = 0
DAMPING_SCALE = 1
AREAL_DENSITY = 2
SUPPORT_STIFFNESS = 3
SUPPORT_DAMPING = 4
DRAG = 5
TISSUE_PARAMETERS = 6

# parameters of one contact pair
CONTACT_STIFFNESS = 0
CONTACT_DAMPING = 1
CONTACT_PARAMETERS = 2

# inputs of one instrument: position, unit quaternion w, x, y, z
POSE = 7

# outputs of one instrument
FORCE = 0
TORQUE = 3
MEAN_FORCE = 6
DEPTH = 9
CONTACT_POINT = 10
CONTACTS = 13
INSTRUMENT_OUTPUTS = 14

# outputs after those of the instruments
ENERGY_KINETIC = 0
ENERGY_ELASTIC = 1
ENERGY_CONTACT = 2
ENERGY_DISSIPATED = 3
ENERGY_WORK = 4
ENERGY_BALANCE = 5
SUBSTEPS = 6
REJECTED_PAIRS = 7
PAIRS = 8
COMMON_OUTPUTS = 9

# what the response gathers for one instrument in scratch.contact
GATHER_FORCE = 0
GATHER_TORQUE = 3
GATHER_DEPTH = 6
GATHER_REGIONS = 7
GATHER_SIZE = 8  # sum of the sizes of the forces
GATHER_POINT = 9  # sum of size times point
GATHER = 12
