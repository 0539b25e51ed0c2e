/* A free-flying camera that closes the loop in lockstep: publishes features, moves by the twists that come back.
 *
 *     vpcd --scene ipc/scene/scenes/paper-sim.toml --clock lockstep &
 *     ./camera [DOMAIN [STEPS [TX TY TZ RX RY RZ]]]
 *
 * DOMAIN: directory of the domain, - for /tmp/vpc-<uid>. STEPS: most periods. The rest: the object in the camera frame
 * at the start, m and rotation vector in rad. The scene is paper-sim's, written out below. Exit code 0: at the goal. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "vpc.h"

enum { POINTS = 4 };
static const double FOCAL = 800.0, CENTRE = 512.0, PERIOD = 1.0 / 30.0, CONVERGENCE_PX = 2.0;
static const double PATTERN[POINTS][3] = {
    {-0.15, -0.15, 0.0}, {0.15, -0.15, 0.0}, {0.15, 0.15, 0.0}, {-0.15, 0.15, 0.0}};
static const double GOAL[6] = {0.0, 0.0, 0.6, 0.0, 0.0, 0.0};
static const uint64_t PATIENCE_NS = 10000000000u;

typedef struct {
    double at[3];
} point;

static point cross(const double a[3], const double b[3]) {
    return (point){{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}};
}

/* first p + second (w x p) + third (w x (w x p)) */
static point series(const double w[3], const double p[3], double first, double second, double third) {
    const point once = cross(w, p), twice = cross(w, once.at);
    point sum;
    for (int k = 0; k < 3; k++) {
        sum.at[k] = first * p[k] + second * once.at[k] + third * twice.at[k];
    }
    return sum;
}

/* sin x / x, (1 - cos x) / x^2, (x - sin x) / x^3 */
static void coefficients(double x, double out[3]) {
    if (x < 1e-4) {
        out[0] = 1.0 - x * x / 6.0, out[1] = 0.5 - x * x / 24.0, out[2] = 1.0 / 6.0 - x * x / 120.0;
    } else {
        out[0] = sin(x) / x, out[1] = (1.0 - cos(x)) / (x * x), out[2] = (x - sin(x)) / (x * x * x);
    }
}

static double length(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

/* The pattern in the camera frame, where the object is at `pose`. */
static void place(const double pose[6], point seen[POINTS]) {
    double c[3];
    coefficients(length(pose + 3), c);
    for (int i = 0; i < POINTS; i++) {
        seen[i] = series(pose + 3, PATTERN[i], 1.0, c[0], c[1]);
        for (int k = 0; k < 3; k++) {
            seen[i].at[k] += pose[k];
        }
    }
}

/* Exact rigid motion of the camera by a constant twist in its own frame: its new frame is (exp(w), V(w) v) in the old
 * one, so points change by the inverse of that. */
static void move(const double twist[6], point seen[POINTS]) {
    double v[3], w[3], back[3], c[3];
    for (int k = 0; k < 3; k++) {
        v[k] = twist[k] * PERIOD, w[k] = twist[k + 3] * PERIOD, back[k] = -w[k];
    }
    coefficients(length(w), c);
    const point shift = series(w, v, 1.0, c[1], c[2]);
    for (int i = 0; i < POINTS; i++) {
        double left[3];
        for (int k = 0; k < 3; k++) {
            left[k] = seen[i].at[k] - shift.at[k];
        }
        seen[i] = series(back, left, 1.0, c[0], c[1]);
    }
}

static void project(const point seen[POINTS], double pixels[2 * POINTS]) {
    for (int i = 0; i < POINTS; i++) {
        for (int k = 0; k < 2; k++) {
            pixels[2 * i + k] = CENTRE + FOCAL * seen[i].at[k] / seen[i].at[2];
        }
    }
}

static int complain(const char *what) {
    fprintf(stderr, "camera: %s: %s\n", what, vpc_message());
    return 2;
}

int main(int count, char **words) {
    const char *directory = count > 1 && strcmp(words[1], "-") != 0 ? words[1] : NULL;
    const int most = count > 2 ? atoi(words[2]) : 450;
    double start[6] = {0.2, 0.0, 0.7, 0.0, 0.0, 0.0};
    for (int k = 0; k < 6 && count > 3 + k; k++) {
        start[k] = atof(words[3 + k]);
    }

    vpc_domain *domain = NULL;
    vpc_camera *camera = NULL;
    if (vpc_domain_join(directory, &domain) != VPC_STATUS_OK) return complain("joining");
    if (vpc_camera_open(domain, &camera) != VPC_STATUS_OK) return complain("opening the ports");

    point seen[POINTS];
    double wanted[2 * POINTS], pixels[2 * POINTS], error = INFINITY;
    place(GOAL, seen);
    project(seen, wanted);
    place(start, seen);
    vpc_twist_command twist = {0};
    int step = 0;
    for (;; step++) {
        project(seen, pixels);
        error = 0.0;
        for (int k = 0; k < 2 * POINTS; k++) {
            error = fmax(error, fabs(pixels[k] - wanted[k]));
        }
        if (error <= CONVERGENCE_PX || step == most) break;
        vpc_features features;
        vpc_sent sent;
        if (vpc_features_of(pixels, POINTS, &features) != VPC_STATUS_OK ||
            vpc_camera_publish(camera, &features, &sent) != VPC_STATUS_OK) {
            return complain("publishing");
        }
        if (vpc_camera_wait(camera, &sent, PATIENCE_NS, &twist) != VPC_STATUS_OK) return complain("waiting");
        move(twist.twist, seen);
    }
    printf("%d steps, final error %.3f px (threshold %.1f px), controller %s\n", step, error, CONVERGENCE_PX,
           vpc_state_name(twist.state));
    vpc_camera_close(camera);
    vpc_domain_leave(domain);
    return error <= CONVERGENCE_PX ? 0 : 1;
}
