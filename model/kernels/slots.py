"""Where each quantity lies in the vectors of parameters, inputs and outputs.

Parameters: `TISSUE_PARAMETERS` for each tissue, `CONTACT_PARAMETERS` for each contact, `GRASP_PARAMETERS` for each
grasper. Inputs: a pose for each instrument, then the jaw of each grasper. Outputs: `BODY_OUTPUTS` for each instrument
and then for each rigid body, the energies, the solver's counters, three coordinates for each probe and one count for
each grasper.
"""

# parameters of one tissue
STIFFNESS_SCALE = 0
DAMPING_SCALE = 1
AREAL_DENSITY = 2
SUPPORT_STIFFNESS = 3
SUPPORT_DAMPING = 4
DRAG = 5
NONLINEARITY = 6
AREA_STIFFNESS = 7
VOLUME_STIFFNESS = 8
TISSUE_PARAMETERS = 9

# parameters of one contact: of the whole contact, or per area where depth is read in a distance field
CONTACT_STIFFNESS = 0
CONTACT_DAMPING = 1  # damping of Kelvin-Voigt, dissipation of Hunt-Crossley
CONTACT_EXPONENT = 2
CONTACT_FRICTION = 3
CONTACT_PARAMETERS = 4

# parameters of one grasper
GRASP_STIFFNESS = 0
GRASP_DAMPING = 1
GRASP_SLIP_FORCE = 2
GRASP_PARAMETERS = 3

# inputs of one instrument: position, unit quaternion w, x, y, z
POSE = 7

# outputs of one instrument or rigid body
FORCE = 0
TORQUE = 3
MEAN_FORCE = 6
DEPTH = 9
CONTACT_POINT = 10
CONTACTS = 13
BODY_OUTPUTS = 14

# outputs after those of the bodies
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

# what the contacts gather for one body in scratch.contact
GATHER_FORCE = 0
GATHER_TORQUE = 3
GATHER_DEPTH = 6
GATHER_REGIONS = 7
GATHER_SIZE = 8  # sum of the sizes of the forces
GATHER_POINT = 9  # sum of size times point
GATHER = 12
