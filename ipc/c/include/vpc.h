/* The shared-memory contract of vpcd for C: camera, observer, operator.
 *
 * Generated from the Rust sources, do not edit: VPC_BLESS=1 cargo test -p vpc-client-c
 * What the messages mean: ipc/CONTRACT.md. How to build with it, and examples: ipc/c/README.md.
 *
 * Threads. A handle (domain, camera, observer, operator) belongs to the thread that made it, and so do the ports opened
 * with it; from another one functions return VPC_STATUS_THREAD. A second thread joins for itself.
 * Pointers. Each may be NULL, which is refused with VPC_STATUS_ARGUMENT where it is needed; any other value must be
 * valid: a handle not yet closed, a place for the type. Nothing is kept after a function returns.
 * Order. Ports keep their domain: they may be closed before or after vpc_domain_leave.
 * Results. VPC_STATUS_OK is 0; below 0 is an error; vpc_message() has its words. No panic crosses the border.
 * Times are CLOCK_MONOTONIC in ns, image points px, twists m/s and rad/s in the camera frame.
 */

#ifndef VPC_H
#define VPC_H

#include <stddef.h>
#include <stdint.h>

#define VPC_MAX_POINTS 8

// A command was not valid in time.
#define VPC_ROBOT_FAULTS_STALE_COMMAND 1

// A command was outside the limits and was cut.
#define VPC_ROBOT_FAULTS_COMMAND_LIMITED 2

// The robot's own reflex stopped it (Panda: a discontinuity or a limit of a joint).
#define VPC_ROBOT_FAULTS_REFLEX 4

// A joint is at the limit of its range.
#define VPC_ROBOT_FAULTS_JOINT_LIMIT 8

// The pattern left the image or went behind the camera.
#define VPC_ROBOT_FAULTS_PATTERN_LOST 16

// Real time was asked for.
#define VPC_REALTIME_ASKED 1

// ... and the thread has no SCHED_FIFO.
#define VPC_REALTIME_NO_FIFO 2

// ... and the thread is not on its processor.
#define VPC_REALTIME_NO_CPU 4

// ... and memory is not locked.
#define VPC_REALTIME_NO_LOCK 8

// What every function returns but those that cannot fail: 0 done, above 0 nothing went wrong but there is no answer,
// below 0 an error. `vpc_message()` has the words.
enum vpc_status
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // Done.
    VPC_STATUS_OK = 0,
    // No message is waiting.
    VPC_STATUS_NOTHING = 1,
    // No answer came in time: no controller is at work, or it is not of this domain.
    VPC_STATUS_TIMEOUT = 2,
    // The controller refused the request; the reply's `outcome` says why.
    VPC_STATUS_REFUSED = 3,
    // An argument is NULL or outside its range.
    VPC_STATUS_ARGUMENT = -1,
    // The domain cannot be joined.
    VPC_STATUS_DOMAIN = -2,
    // The place is taken: another camera is at work in this domain, or as many operators or observers as fit.
    VPC_STATUS_TAKEN = -3,
    // A port cannot be opened.
    VPC_STATUS_OPEN = -4,
    // A message was not sent.
    VPC_STATUS_PUBLISH = -5,
    // Nothing can be received.
    VPC_STATUS_RECEIVE = -6,
    // A message came that breaks the contract, and was thrown away.
    VPC_STATUS_INVALID = -7,
    // A handle was used in another thread than the one that made it.
    VPC_STATUS_THREAD = -8,
    // A defect of this library. Close the handle; the program may go on.
    VPC_STATUS_PANIC = -9,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_status vpc_status;
#else
typedef int32_t vpc_status;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What the controller is about.
enum vpc_state
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // No run is under way: start-up or shutdown; the twist is zero.
    VPC_STATE_STOPPED = 0,
    // On the way to the goal.
    VPC_STATE_MOVING = 1,
    // The image error is below the scene's convergence threshold; the controller keeps regulating.
    VPC_STATE_ARRIVED = 2,
    // Features are missing, stale or refused; the twist is zero until good ones come.
    VPC_STATE_HOLDING = 3,
    // Slowing down to zero, at the deceleration of the configuration.
    VPC_STATE_BRAKING = 4,
    // The twist is zero until an operator arms the controller.
    VPC_STATE_DISARMED = 5,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_state vpc_state;
#else
typedef uint32_t vpc_state;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What the robot does with commands.
enum vpc_robot_mode
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // It waits for a first valid command.
    VPC_ROBOT_MODE_IDLE = 0,
    // It executes commands.
    VPC_ROBOT_MODE_MOVING = 1,
    // It stopped because the last command is no longer valid.
    VPC_ROBOT_MODE_STALE = 2,
    // It stopped by itself; see the faults.
    VPC_ROBOT_MODE_FAULT = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_robot_mode vpc_robot_mode;
#else
typedef uint32_t vpc_robot_mode;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What starts a cycle.
enum vpc_clock_mode
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // An absolute grid in time.
    VPC_CLOCK_MODE_FIXED = 0,
    // Each new features message.
    VPC_CLOCK_MODE_LOCKSTEP = 1,
    // A grid in time that keeps the nominal rate and follows the camera's phase.
    VPC_CLOCK_MODE_PHASE = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_clock_mode vpc_clock_mode;
#else
typedef uint32_t vpc_clock_mode;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What the grid of releases has to do with the camera's frames.
enum vpc_phase
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // Nothing: the clock is another one, or no frames come.
    VPC_PHASE_FREE = 0,
    // It is on the way to the camera's phase.
    VPC_PHASE_SEEKING = 1,
    // It follows it.
    VPC_PHASE_LOCKED = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_phase vpc_phase;
#else
typedef uint32_t vpc_phase;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Why a cycle did not send the law's twist.
enum vpc_hold
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // It did not: the law's twist was sent.
    VPC_HOLD_NONE = 0,
    // No features have come yet.
    VPC_HOLD_NO_FEATURES = 1,
    // The latest features are older than the stale limit.
    VPC_HOLD_STALE = 2,
    // A message was refused on reception: count or numbers.
    VPC_HOLD_INVALID = 3,
    // A point was not visible.
    VPC_HOLD_HIDDEN = 4,
    // The count of points is not the pattern's.
    VPC_HOLD_COUNT = 5,
    // A point is not finite.
    VPC_HOLD_NOT_FINITE = 6,
    // A point lies outside the image.
    VPC_HOLD_OFF_IMAGE = 7,
    // The shared memory failed.
    VPC_HOLD_TRANSPORT = 8,
    // The law gave a twist that is not finite or beyond the limits.
    VPC_HOLD_BAD_TWIST = 9,
    // Features came in the wrong order: older than those before, from the same camera.
    VPC_HOLD_ORDER = 10,
    // Features bear the time of the future, or the clock jumped.
    VPC_HOLD_CLOCK = 11,
    // The solver failed several cycles in a row.
    VPC_HOLD_SOLVER = 12,
    // The robot reports a fault or a reflex.
    VPC_HOLD_ROBOT_FAULT = 13,
    // The robot's state was coming and fell silent.
    VPC_HOLD_ROBOT_LOST = 14,
    // Several releases in a row were missed.
    VPC_HOLD_OVERRUNS = 15,
    // Nobody has armed the controller yet.
    VPC_HOLD_NOT_ARMED = 16,
    // An operator disarmed or stopped it.
    VPC_HOLD_OPERATOR = 17,
    // The daemon is shutting down.
    VPC_HOLD_SHUTDOWN = 18,
    // No usable features came for so long that the camera was disarmed.
    VPC_HOLD_LOST = 19,
    // The loop itself stood still for that long.
    VPC_HOLD_STANDSTILL = 20,
    // Points lie in each other's places (they turn the other way than the pattern, or changed their names), in one
    // place, all on a line, or leap.
    VPC_HOLD_MIXED = 21,
    // Not one bit of the features changed, though the camera was commanded to move.
    VPC_HOLD_FROZEN = 22,
    // The memory's answers were out of range several cycles in a row.
    VPC_HOLD_RECALL = 23,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_hold vpc_hold;
#else
typedef uint32_t vpc_hold;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// How the solver ended.
enum vpc_solver
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // It did not run.
    VPC_SOLVER_IDLE = 0,
    // Optimal to the tolerance, no constraint violated.
    VPC_SOLVER_CONVERGED = 1,
    // Feasible, but the iterations ran out.
    VPC_SOLVER_ITERATION_LIMIT = 2,
    // No further decrease.
    VPC_SOLVER_STALLED = 3,
    // The best plan violates a constraint.
    VPC_SOLVER_INFEASIBLE = 4,
    // No plan could be computed.
    VPC_SOLVER_NUMERICAL_FAILURE = 5,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_solver vpc_solver;
#else
typedef uint32_t vpc_solver;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What the memory had to say.
enum vpc_recall
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // It was not asked: no features near a border, or a strategy without memory.
    VPC_RECALL_UNASKED = 0,
    // Its warm start and way point were followed.
    VPC_RECALL_FOLLOWED = 1,
    // Its answer was out of range; the cycle went without.
    VPC_RECALL_REFUSED = 2,
    // The law was stalled: the way point is a sample's features, back on a stored trajectory.
    VPC_RECALL_DETOUR = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_recall vpc_recall;
#else
typedef uint32_t vpc_recall;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Strategy of the law.
enum vpc_strategy
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // Warm start from the previous cycle.
    VPC_STRATEGY_PREVIOUS = 0,
    // k nearest neighbours of the memory.
    VPC_STRATEGY_KNN = 1,
    // Gaussian-process regression over the memory.
    VPC_STRATEGY_GPR = 2,
    // Classic image-based visual servoing.
    VPC_STRATEGY_IBVS = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_strategy vpc_strategy;
#else
typedef uint32_t vpc_strategy;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What an operator asks for.
enum vpc_action
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // Nothing: the answer tells the state.
    VPC_ACTION_STATUS = 0,
    // Let the law move the camera, from the next good features on.
    VPC_ACTION_ARM = 1,
    // Brake to zero, and stay there until the next arm.
    VPC_ACTION_DISARM = 2,
    // Zero at once, without braking, and stay there until the next arm.
    VPC_ACTION_STOP = 3,
    // Change the strategy of the law.
    VPC_ACTION_STRATEGY = 4,
    // Write out the flight record.
    VPC_ACTION_RECORD = 5,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_action vpc_action;
#else
typedef uint32_t vpc_action;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What became of a request.
enum vpc_outcome
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // Done, or already so.
    VPC_OUTCOME_DONE = 0,
    // Refused: no good features are coming, so that nothing could be controlled.
    VPC_OUTCOME_NO_FEATURES = 1,
    // Refused: the robot reports a fault, or was heard and fell silent.
    VPC_OUTCOME_ROBOT = 2,
    // Refused: the camera still brakes; ask again when it stands.
    VPC_OUTCOME_BRAKING = 3,
    // Refused: the controller's memory of motion lacks what the strategy needs, or there is no memory.
    VPC_OUTCOME_NO_MEMORY = 4,
    // Refused: neighbours out of range (knn: 1 to 64; other strategies: 0).
    VPC_OUTCOME_NEIGHBOURS = 5,
    // Refused: the controller is shutting down.
    VPC_OUTCOME_SHUTDOWN = 6,
    // Refused: the controller keeps no flight record.
    VPC_OUTCOME_NO_RECORD = 7,
    // Refused: the code of the action or of the strategy is none of the contract's.
    VPC_OUTCOME_UNKNOWN = 8,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_outcome vpc_outcome;
#else
typedef uint32_t vpc_outcome;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Which of the messages that wait is taken.
enum vpc_take
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // The one that waited longest: for who wants all of them.
    VPC_TAKE_OLDEST = 0,
    // The newest; those before it are thrown away.
    VPC_TAKE_LATEST = 1,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum vpc_take vpc_take;
#else
typedef uint32_t vpc_take;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Publishes features and the robot's state, receives twists.
typedef struct vpc_camera vpc_camera;

// Membership of a domain.
typedef struct vpc_domain vpc_domain;

// Receives everything and sends nothing.
typedef struct vpc_observer vpc_observer;

// Asks the controller, and waits for its answers.
typedef struct vpc_operator vpc_operator;

// Head of every message.
typedef struct {
    // Number of the message, from 1, by one more for each message of one publisher; a publisher that restarts
    // starts from 1 again.
    uint64_t sequence;
    // When the message was published, CLOCK_MONOTONIC, ns.
    uint64_t published_ns;
    // The instant that the data describe, CLOCK_MONOTONIC, ns: for features the middle of the exposure.
    uint64_t data_ns;
} vpc_stamp;

// Image features of one frame; service vpc/features.
typedef struct {
    // Head; data_ns is the middle of the exposure.
    vpc_stamp stamp;
    // Length of the exposure, ns; 0 where unknown.
    uint64_t exposure_ns;
    // Points in this message, 1 to 8, in the order of the pattern.
    uint32_t count;
    // Bit i is set where point i was measured in this frame; a point that was not carries the tracker's guess.
    uint32_t visible;
    // Image points u1 v1 u2 v2 ..., px; u to the right, v down, origin at the centre of the upper left pixel. The first
    // 2 * count are finite; the rest is zero.
    double points[16];
} vpc_features;

// What became of features that were published: what their answer bears.
typedef struct {
    // Their sequence number.
    uint64_t sequence;
    // Their time of publication, ns.
    uint64_t published_ns;
} vpc_sent;

// Camera velocity command; service vpc/twist.
// 
// Whoever executes it stops when it is no longer valid: a silent controller never leaves its last command standing.
typedef struct {
    // Head; data_ns is that of the features it answers.
    vpc_stamp stamp;
    // Sequence number of the features it answers; 0 where it answers none.
    uint64_t features_sequence;
    // published_ns of the features it answers, which tells a restarted camera's message from its predecessor's.
    uint64_t features_published_ns;
    // The command holds until this instant, CLOCK_MONOTONIC, ns; afterwards the camera must stop. u64::MAX in
    // lockstep, where time does not pass between frames.
    uint64_t valid_until_ns;
    // A vpc_state code.
    uint32_t state;
    // Zero.
    uint32_t reserved;
    // Velocity of the camera in the camera frame (x right, y down, z forward): vx vy vz in m/s, wx wy wz in rad/s;
    // finite, inside the scene's limits.
    double twist[6];
} vpc_twist_command;

// State of the robot that carries the camera, at the instant stamp.data_ns; service vpc/robot.
typedef struct {
    // Head.
    vpc_stamp stamp;
    // Sequence number of the features exposed at this instant; 0 where none were.
    uint64_t features_sequence;
    // A vpc_robot_mode code.
    uint32_t mode;
    // Bits of vpc_robot_faults.
    uint32_t faults;
    // Object in the camera frame: translation, m.
    double translation[3];
    // Object in the camera frame: rotation vector (axis times angle), rad.
    double rotation[3];
    // Camera velocity in the camera frame as it is carried out: vx vy vz in m/s, wx wy wz in rad/s.
    double twist[6];
    // Joints in q and dq, 0 for a free-flying camera, 7 for a Panda.
    uint32_t joints;
    // Zero.
    uint32_t reserved;
    // Joint positions, base to flange, rad.
    double q[7];
    // Joint velocities, base to flange, rad/s.
    double dq[7];
    // Zero; room for what a real arm will want to say.
    double room[8];
} vpc_robot_state;

// Telemetry of one cycle; service vpc/cycles. Numbers of the law are NaN where it did not run.
typedef struct {
    // Head; data_ns is when the cycle woke up.
    vpc_stamp stamp;
    // Number of the cycle, from 1.
    uint64_t cycle;
    // A vpc_clock_mode code.
    uint32_t clock;
    // A vpc_solver code.
    uint32_t status;
    // Wake-up after the release, ns; 0 in lockstep.
    uint64_t wake_latency_ns;
    // Time taken by receiving and the gate, ns.
    uint64_t receive_ns;
    // Time taken by the law, ns.
    uint64_t step_ns;
    // Time taken by sending, ns.
    uint64_t send_ns;
    // Releases missed since the start.
    uint64_t overruns;
    // Sequence number of the features used; 0 where none were.
    uint64_t features_sequence;
    // Age of the features used when the cycle woke up, from the middle of the exposure, ns.
    uint64_t features_age_ns;
    // Records lost since the start because the recorder was slower than the loop.
    uint64_t lost_records;
    // Points in points, 0 to 8.
    uint32_t count;
    // Points in way_point: 0 where the goal is tracked.
    uint32_t way_point_count;
    // A vpc_recall.
    uint32_t recalled;
    // A vpc_strategy.
    uint32_t strategy;
    // Neighbours averaged by k-NN; 0 for other strategies.
    uint32_t neighbours;
    // Steps previewed.
    uint32_t np;
    // Iterations of the solver.
    uint32_t iterations;
    // Active-set changes in its quadratic programs.
    uint32_t qp_iterations;
    // A vpc_hold code.
    uint32_t hold;
    // A vpc_state code.
    uint32_t state;
    // Features used, u1 v1 u2 v2 ..., px.
    double points[16];
    // Way point tracked instead of the goal, u1 v1 u2 v2 ..., px.
    double way_point[16];
    // Camera twist that was sent, camera frame, m/s and rad/s.
    double twist[6];
    // The paper's running cost of the command that was sent.
    double cost;
    // Worst violation predicted over the window, px.
    double violation_px;
    // Least clearance of a feature from an occlusion, px; infinite in a scene without any.
    double clearance_px;
    // Largest component of s - s*, px.
    double error_px;
    // vpc_realtime bits.
    uint32_t realtime;
    // A vpc_phase.
    uint32_t phase;
    // This release after the one that the camera's phase asks for, ns; 0 while the grid is free.
    int64_t phase_error_ns;
    // Page faults of the loop's thread from wake to send that were served without a disk.
    uint32_t minor_faults;
    // ... that waited for a disk.
    uint32_t major_faults;
    // Times that the loop's thread gave up its processor from wake to send, because a call blocked.
    uint32_t blocked;
    // Calls of the heap by the loop's thread from wake to send, where the allocator counts them.
    uint32_t allocations;
    // Zero: room to grow.
    uint64_t room[4];
} vpc_cycle_record;

// The controller's answer to a request; service vpc/replies.
typedef struct {
    // Head; data_ns is the publication of the request.
    vpc_stamp stamp;
    // The request's.
    uint64_t id;
    // The request's vpc_action code; zero where that is unknown.
    uint32_t action;
    // An vpc_outcome code.
    uint32_t outcome;
    // A vpc_state code: the state after the request.
    uint32_t state;
    // A vpc_hold code: the cause of that state.
    uint32_t hold;
    // A vpc_strategy: the strategy after the request.
    uint32_t strategy;
    // Its neighbours (knn), else zero.
    uint32_t neighbours;
} vpc_reply;

// An operator's request; service vpc/requests. Several operators may be at work.
typedef struct {
    // Head; data_ns is zero.
    vpc_stamp stamp;
    // Chosen by the operator, so that the answer can be told from those to others.
    uint64_t id;
    // An vpc_action code.
    uint32_t action;
    // For strategy: a vpc_strategy; else zero.
    uint32_t strategy;
    // For strategy knn: neighbours averaged, 1 to 64; else zero.
    uint32_t neighbours;
    // Zero.
    uint32_t reserved;
} vpc_request;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// What went wrong last in this thread, in words; empty where nothing did. Valid until the next call of this library
// in this thread.
const char *vpc_message(void);

// Joins the domain in `directory`, which is created where it is missing; NULL: /tmp/vpc-UID. The handle and what
// is opened with it stay in this thread.
vpc_status vpc_domain_join(const char *directory,
                           vpc_domain **out);

// Leaves the domain when the last port opened with it is closed, too. NULL does nothing.
vpc_status vpc_domain_leave(vpc_domain *domain);

// CLOCK_MONOTONIC in ns: the clock of all stamps.
uint64_t vpc_now_ns(void);

// Opens the camera's ports. VPC_STATUS_TAKEN while another camera is at work.
vpc_status vpc_camera_open(vpc_domain *domain, vpc_camera **out);

// Closes the camera's ports. NULL does nothing.
vpc_status vpc_camera_close(vpc_camera *camera);

// Fills in features: `count` points u1 v1 u2 v2 ... in px, 1 to 8, all visible, no times.
vpc_status vpc_features_of(const double *points, uint32_t count, vpc_features *out);

// Publishes features under the next sequence number. `stamp.published_ns` 0 becomes the present time and
// `stamp.data_ns` 0 becomes `published_ns`; other values stand (simulated time in lockstep, the exposure of a real
// camera). `sent` may be NULL.
vpc_status vpc_camera_publish(vpc_camera *camera,
                              const vpc_features *features,
                              vpc_sent *sent);

// Counts from 1 again: the next features begin a new run, for which the controller forgets everything.
vpc_status vpc_camera_restart(vpc_camera *camera);

// Lockstep: waits for the answer to features that were `sent`, at most `patience_ns`; VPC_STATUS_TIMEOUT when none
// came. A controller that starts meanwhile gets them.
vpc_status vpc_camera_wait(vpc_camera *camera,
                           const vpc_sent *sent,
                           uint64_t patience_ns,
                           vpc_twist_command *out);

// The newest command since the last call; VPC_STATUS_NOTHING where there is none. It may be executed until its
// `valid_until_ns`, never longer: stop then.
vpc_status vpc_camera_twist(vpc_camera *camera,
                            vpc_twist_command *out);

// Publishes the robot's state; sequence and time of publication are filled in, the rest is as given.
vpc_status vpc_camera_publish_robot(vpc_camera *camera,
                                    const vpc_robot_state *state);

// Opens an observer's ports. VPC_STATUS_TAKEN where a service has all the subscribers that it takes.
vpc_status vpc_observer_open(vpc_domain *domain,
                             vpc_observer **out);

// Closes an observer's ports. NULL does nothing.
vpc_status vpc_observer_close(vpc_observer *observer);

// What the camera saw; VPC_STATUS_NOTHING where no message is waiting. `take` is a vpc_take. `missed` (may be NULL)
// counts messages since the one before that were lost or thrown away.
vpc_status vpc_observer_features(vpc_observer *observer,
                                 uint32_t take,
                                 vpc_features *out,
                                 uint64_t *missed);

// What the controller commanded; as vpc_observer_features.
vpc_status vpc_observer_twist(vpc_observer *observer,
                              uint32_t take,
                              vpc_twist_command *out,
                              uint64_t *missed);

// Where the robot is; as vpc_observer_features.
vpc_status vpc_observer_robot(vpc_observer *observer,
                              uint32_t take,
                              vpc_robot_state *out,
                              uint64_t *missed);

// What the controller's cycles did; as vpc_observer_features.
vpc_status vpc_observer_cycle(vpc_observer *observer,
                              uint32_t take,
                              vpc_cycle_record *out,
                              uint64_t *missed);

// Opens an operator's ports. VPC_STATUS_TAKEN where as many operators are at work as fit: stay no longer than needed.
vpc_status vpc_operator_open(vpc_domain *domain,
                             vpc_operator **out);

// Closes an operator's ports. NULL does nothing.
vpc_status vpc_operator_close(vpc_operator *operator_);

// Sends a request and waits for the answer, at most `patience_ns`. `action` is a vpc_action; for
// VPC_ACTION_STRATEGY, `strategy` is a vpc_strategy and `neighbours` 1 to 64 with knn; otherwise both are 0. `out`
// (may be NULL) gets the answer, also of VPC_STATUS_REFUSED.
vpc_status vpc_operator_ask(vpc_operator *operator_,
                            uint32_t action,
                            uint32_t strategy,
                            uint32_t neighbours,
                            uint64_t patience_ns,
                            vpc_reply *out);

// Lets the law move the camera, from the next good features on; waits for the answer, at most a second.
vpc_status vpc_arm(vpc_operator *operator_,
                   vpc_reply *out);

// Brakes to zero and stays there until the next vpc_arm; waits for the answer, at most a second.
vpc_status vpc_disarm(vpc_operator *operator_, vpc_reply *out);

// Zero at once, without braking, until the next vpc_arm; waits for the answer, at most a second.
vpc_status vpc_stop(vpc_operator *operator_, vpc_reply *out);

// A vpc_state in words; "unknown" for other numbers. Valid for ever, as those below.
const char *vpc_state_name(uint32_t code);

// A vpc_hold in words.
const char *vpc_hold_name(uint32_t code);

// A vpc_outcome in words.
const char *vpc_outcome_name(uint32_t code);

// A vpc_strategy in words.
const char *vpc_strategy_name(uint32_t code);

// A vpc_solver in words.
const char *vpc_solver_name(uint32_t code);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* VPC_H */


/* The layout, as the Rust compiler has it. */
#if defined(__cplusplus)
#define VPC_ASSERT(condition, words) static_assert(condition, words)
#else
#define VPC_ASSERT(condition, words) _Static_assert(condition, words)
#endif
VPC_ASSERT(sizeof(vpc_stamp) == 24, "vpc_stamp");
VPC_ASSERT(offsetof(vpc_stamp, sequence) == 0, "vpc_stamp.sequence");
VPC_ASSERT(offsetof(vpc_stamp, published_ns) == 8, "vpc_stamp.published_ns");
VPC_ASSERT(offsetof(vpc_stamp, data_ns) == 16, "vpc_stamp.data_ns");
VPC_ASSERT(sizeof(vpc_features) == 168, "vpc_features");
VPC_ASSERT(offsetof(vpc_features, stamp) == 0, "vpc_features.stamp");
VPC_ASSERT(offsetof(vpc_features, exposure_ns) == 24, "vpc_features.exposure_ns");
VPC_ASSERT(offsetof(vpc_features, count) == 32, "vpc_features.count");
VPC_ASSERT(offsetof(vpc_features, visible) == 36, "vpc_features.visible");
VPC_ASSERT(offsetof(vpc_features, points) == 40, "vpc_features.points");
VPC_ASSERT(sizeof(vpc_twist_command) == 104, "vpc_twist_command");
VPC_ASSERT(offsetof(vpc_twist_command, stamp) == 0, "vpc_twist_command.stamp");
VPC_ASSERT(offsetof(vpc_twist_command, features_sequence) == 24, "vpc_twist_command.features_sequence");
VPC_ASSERT(offsetof(vpc_twist_command, features_published_ns) == 32, "vpc_twist_command.features_published_ns");
VPC_ASSERT(offsetof(vpc_twist_command, valid_until_ns) == 40, "vpc_twist_command.valid_until_ns");
VPC_ASSERT(offsetof(vpc_twist_command, state) == 48, "vpc_twist_command.state");
VPC_ASSERT(offsetof(vpc_twist_command, reserved) == 52, "vpc_twist_command.reserved");
VPC_ASSERT(offsetof(vpc_twist_command, twist) == 56, "vpc_twist_command.twist");
VPC_ASSERT(sizeof(vpc_robot_state) == 320, "vpc_robot_state");
VPC_ASSERT(offsetof(vpc_robot_state, stamp) == 0, "vpc_robot_state.stamp");
VPC_ASSERT(offsetof(vpc_robot_state, features_sequence) == 24, "vpc_robot_state.features_sequence");
VPC_ASSERT(offsetof(vpc_robot_state, mode) == 32, "vpc_robot_state.mode");
VPC_ASSERT(offsetof(vpc_robot_state, faults) == 36, "vpc_robot_state.faults");
VPC_ASSERT(offsetof(vpc_robot_state, translation) == 40, "vpc_robot_state.translation");
VPC_ASSERT(offsetof(vpc_robot_state, rotation) == 64, "vpc_robot_state.rotation");
VPC_ASSERT(offsetof(vpc_robot_state, twist) == 88, "vpc_robot_state.twist");
VPC_ASSERT(offsetof(vpc_robot_state, joints) == 136, "vpc_robot_state.joints");
VPC_ASSERT(offsetof(vpc_robot_state, reserved) == 140, "vpc_robot_state.reserved");
VPC_ASSERT(offsetof(vpc_robot_state, q) == 144, "vpc_robot_state.q");
VPC_ASSERT(offsetof(vpc_robot_state, dq) == 200, "vpc_robot_state.dq");
VPC_ASSERT(offsetof(vpc_robot_state, room) == 256, "vpc_robot_state.room");
VPC_ASSERT(sizeof(vpc_cycle_record) == 544, "vpc_cycle_record");
VPC_ASSERT(offsetof(vpc_cycle_record, stamp) == 0, "vpc_cycle_record.stamp");
VPC_ASSERT(offsetof(vpc_cycle_record, cycle) == 24, "vpc_cycle_record.cycle");
VPC_ASSERT(offsetof(vpc_cycle_record, clock) == 32, "vpc_cycle_record.clock");
VPC_ASSERT(offsetof(vpc_cycle_record, status) == 36, "vpc_cycle_record.status");
VPC_ASSERT(offsetof(vpc_cycle_record, wake_latency_ns) == 40, "vpc_cycle_record.wake_latency_ns");
VPC_ASSERT(offsetof(vpc_cycle_record, receive_ns) == 48, "vpc_cycle_record.receive_ns");
VPC_ASSERT(offsetof(vpc_cycle_record, step_ns) == 56, "vpc_cycle_record.step_ns");
VPC_ASSERT(offsetof(vpc_cycle_record, send_ns) == 64, "vpc_cycle_record.send_ns");
VPC_ASSERT(offsetof(vpc_cycle_record, overruns) == 72, "vpc_cycle_record.overruns");
VPC_ASSERT(offsetof(vpc_cycle_record, features_sequence) == 80, "vpc_cycle_record.features_sequence");
VPC_ASSERT(offsetof(vpc_cycle_record, features_age_ns) == 88, "vpc_cycle_record.features_age_ns");
VPC_ASSERT(offsetof(vpc_cycle_record, lost_records) == 96, "vpc_cycle_record.lost_records");
VPC_ASSERT(offsetof(vpc_cycle_record, count) == 104, "vpc_cycle_record.count");
VPC_ASSERT(offsetof(vpc_cycle_record, way_point_count) == 108, "vpc_cycle_record.way_point_count");
VPC_ASSERT(offsetof(vpc_cycle_record, recalled) == 112, "vpc_cycle_record.recalled");
VPC_ASSERT(offsetof(vpc_cycle_record, strategy) == 116, "vpc_cycle_record.strategy");
VPC_ASSERT(offsetof(vpc_cycle_record, neighbours) == 120, "vpc_cycle_record.neighbours");
VPC_ASSERT(offsetof(vpc_cycle_record, np) == 124, "vpc_cycle_record.np");
VPC_ASSERT(offsetof(vpc_cycle_record, iterations) == 128, "vpc_cycle_record.iterations");
VPC_ASSERT(offsetof(vpc_cycle_record, qp_iterations) == 132, "vpc_cycle_record.qp_iterations");
VPC_ASSERT(offsetof(vpc_cycle_record, hold) == 136, "vpc_cycle_record.hold");
VPC_ASSERT(offsetof(vpc_cycle_record, state) == 140, "vpc_cycle_record.state");
VPC_ASSERT(offsetof(vpc_cycle_record, points) == 144, "vpc_cycle_record.points");
VPC_ASSERT(offsetof(vpc_cycle_record, way_point) == 272, "vpc_cycle_record.way_point");
VPC_ASSERT(offsetof(vpc_cycle_record, twist) == 400, "vpc_cycle_record.twist");
VPC_ASSERT(offsetof(vpc_cycle_record, cost) == 448, "vpc_cycle_record.cost");
VPC_ASSERT(offsetof(vpc_cycle_record, violation_px) == 456, "vpc_cycle_record.violation_px");
VPC_ASSERT(offsetof(vpc_cycle_record, clearance_px) == 464, "vpc_cycle_record.clearance_px");
VPC_ASSERT(offsetof(vpc_cycle_record, error_px) == 472, "vpc_cycle_record.error_px");
VPC_ASSERT(offsetof(vpc_cycle_record, realtime) == 480, "vpc_cycle_record.realtime");
VPC_ASSERT(offsetof(vpc_cycle_record, phase) == 484, "vpc_cycle_record.phase");
VPC_ASSERT(offsetof(vpc_cycle_record, phase_error_ns) == 488, "vpc_cycle_record.phase_error_ns");
VPC_ASSERT(offsetof(vpc_cycle_record, minor_faults) == 496, "vpc_cycle_record.minor_faults");
VPC_ASSERT(offsetof(vpc_cycle_record, major_faults) == 500, "vpc_cycle_record.major_faults");
VPC_ASSERT(offsetof(vpc_cycle_record, blocked) == 504, "vpc_cycle_record.blocked");
VPC_ASSERT(offsetof(vpc_cycle_record, allocations) == 508, "vpc_cycle_record.allocations");
VPC_ASSERT(offsetof(vpc_cycle_record, room) == 512, "vpc_cycle_record.room");
VPC_ASSERT(sizeof(vpc_request) == 48, "vpc_request");
VPC_ASSERT(offsetof(vpc_request, stamp) == 0, "vpc_request.stamp");
VPC_ASSERT(offsetof(vpc_request, id) == 24, "vpc_request.id");
VPC_ASSERT(offsetof(vpc_request, action) == 32, "vpc_request.action");
VPC_ASSERT(offsetof(vpc_request, strategy) == 36, "vpc_request.strategy");
VPC_ASSERT(offsetof(vpc_request, neighbours) == 40, "vpc_request.neighbours");
VPC_ASSERT(offsetof(vpc_request, reserved) == 44, "vpc_request.reserved");
VPC_ASSERT(sizeof(vpc_reply) == 56, "vpc_reply");
VPC_ASSERT(offsetof(vpc_reply, stamp) == 0, "vpc_reply.stamp");
VPC_ASSERT(offsetof(vpc_reply, id) == 24, "vpc_reply.id");
VPC_ASSERT(offsetof(vpc_reply, action) == 32, "vpc_reply.action");
VPC_ASSERT(offsetof(vpc_reply, outcome) == 36, "vpc_reply.outcome");
VPC_ASSERT(offsetof(vpc_reply, state) == 40, "vpc_reply.state");
VPC_ASSERT(offsetof(vpc_reply, hold) == 44, "vpc_reply.hold");
VPC_ASSERT(offsetof(vpc_reply, strategy) == 48, "vpc_reply.strategy");
VPC_ASSERT(offsetof(vpc_reply, neighbours) == 52, "vpc_reply.neighbours");
VPC_ASSERT(sizeof(vpc_sent) == 16, "vpc_sent");
VPC_ASSERT(offsetof(vpc_sent, sequence) == 0, "vpc_sent.sequence");
VPC_ASSERT(offsetof(vpc_sent, published_ns) == 8, "vpc_sent.published_ns");
#undef VPC_ASSERT
