"""Where things lie in the flat arrays that Python and the compiled inner loop share."""

# ---- state (estimates, controller memory) --------------------------------------------------------
Q = 0  # quaternion body -> NED, w x y z
V = 4  # velocity NED m/s
P = 7  # position NED m, z from the ground under the range finder
BIAS = 10  # gyro bias rad/s
ACC_BIAS = 13  # vertical accelerometer bias, m/s^2 down
RATE = 14  # filtered, bias-free body rates rad/s
SUM_GYRO = 17  # x, y summed since the last flow message
SUM_V = 19  # body x, y velocity summed since the last flow message
SUM_N = 21
RANGE_Z = 22  # height the range finder last gave, m (NaN before the first)
BARO = 23  # filtered barometric height m
BARO_OFFSET = 24  # barometric height minus height above ground
FLOW_AGE = 25  # s since the last used flow
RANGE_AGE = 26  # s since the last used range
ACCEL_W = 27  # world acceleration NED m/s^2, filtered
PD = 30  # desired position NED (shaped)
VD = 33  # desired velocity NED (shaped)
AD = 36  # desired acceleration NED (shaped)
IV = 39  # velocity integrators N, E
EV = 41  # filtered velocity error N, E
DV = 43  # filtered derivative of the velocity error N, E
IZ = 45  # vertical acceleration integrator (thrust fraction)
ATT = 46  # target roll, pitch, yaw rad (shaped)
ATT_RATE = 49  # target rates of those rad/s
IR = 52  # rate integrators
RATE_TARGET = 55  # filtered rate targets
RATE_D = 58  # filtered derivatives of the rate error
RATE_E = 61  # previous rate errors
THRUST = 64  # thrust fraction asked of the mixer
SPOOL = 65  # 0 stopped .. 1 free
LIMIT_LOW = 66  # 1 while the throttle is as low as it goes
ANGLE_ERROR = 67  # angle between wanted and estimated attitude, rad
ACCEL_Z_ERROR = 68  # filtered vertical acceleration error
GYRO_FILTER = 69  # low-pass memory of the gyro x, y, z
RANGE_SEEN = 72  # number of ranges used
FLOW_SEEN = 73  # number of flow messages used
STATE_SIZE = 74

# ---- command (written by the modes, read by the controller) --------------------------------------
CONTROL = 0  # 0 motors stopped, 1 idling on the ground, 2 flying
HORIZONTAL = 1  # 0 stay level, 1 velocity, 2 position
VERTICAL = 2  # 0 velocity, 1 position
COMMAND_V = 3  # velocity NED
COMMAND_P = 6  # position NED
YAW_MODE = 9  # 0 rate, 1 angle
COMMAND_YAW = 10  # rad or rad/s
CLIMB_LIMIT = 11  # m/s
NEW_FLOW = 12  # 1 = the next two hold a fresh flow rate
FLOW_X = 13
FLOW_Y = 14
NEW_RANGE = 15  # 1 = the next holds a fresh range
RANGE_M = 16
AIDING = 17  # 1 flow aids the velocity, 0 velocity is taken as zero
RESET = 18  # 1 = forget integrators and start the targets from the estimate
COMMAND_SIZE = 19

STOPPED, IDLE, FLYING = 0, 1, 2
LEVEL, VELOCITY, POSITION = 0, 1, 2
Z_VELOCITY, Z_POSITION = 0, 1
