// Steers as users of ViSP do: a peer of our strategies in `cargo table --external
// ViSP=target/visp`. README.md describes the lines of JSON that it reads and writes. Built from
// the root of the repository, with Debian's libvisp-vs-dev and libvisp-vision-dev, by
//     c++ -O2 -isystem /usr/include/opencv4 tests/peers/visp.cpp -o target/visp
//     -lvisp_vs -lvisp_visual_features -lvisp_robot -lvisp_vision -lvisp_core
//
// The law is vpServo on points: eye in hand, present interaction matrix, depths by vpPose, zero
// where a point is hidden; without a frame the last twist goes on.
// Source: ViSP, example/servo-franka/servoFrankaIBVS.cpp; gain as in the documentation of
// vpAdaptiveGain, which arrives in half the time of the example's 1.5, 0.4, 30.
// --compensate compensates the target's motion, measured as de/dt - J v and filtered.
// Source: ViSP, example/servo-viper850/servoViper850Point2DCamVelocityKalman.cpp.

#include <array>
#include <iostream>
#include <iterator>
#include <limits>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <visp3/core/vpCameraParameters.h>
#include <visp3/core/vpLinearKalmanFilterInstantiation.h>
#include <visp3/robot/vpRobot.h>
#include <visp3/vision/vpPose.h>
#include <visp3/visual_features/vpFeatureBuilder.h>
#include <visp3/visual_features/vpFeaturePoint.h>
#include <visp3/vs/vpAdaptiveGain.h>
#include <visp3/vs/vpServo.h>

namespace {

/// What the command line chooses.
struct Options {
    bool compensates = false;
    /// Gain at zero, at infinity, and slope at zero, 1/s.
    std::array<double, 3> gain{{4.0, 0.4, 30.0}};
    /// Variances of state and measurement, and correlation of the noise.
    std::array<double, 3> filter{{0.00001, 0.05, 0.3}};
};

/// The numbers of a line of JSON behind a key, up to the next string; what is null is left out.
std::vector<double> numbers(const std::string &line, const std::string &key) {
    const std::string quoted = '"' + key + "\":";
    const size_t at = line.find(quoted);
    if (at == std::string::npos) {
        throw std::runtime_error("a line has no `" + key + "`");
    }
    const size_t begin = at + quoted.size();
    std::string text = line.substr(begin, line.find('"', begin) - begin);
    for (char &c : text) {
        if (std::string("+-.0123456789eE").find(c) == std::string::npos) {
            c = ' ';
        }
    }
    std::istringstream words(text);
    return {std::istream_iterator<double>(words), std::istream_iterator<double>()};
}

double number(const std::string &line, const std::string &key) {
    const std::vector<double> found = numbers(line, key);
    if (found.empty()) {
        throw std::runtime_error("`" + key + "` has no number");
    }
    return found[0];
}

/// Pixels of numbers, two each.
std::vector<vpImagePoint> pixels(const std::vector<double> &numbers) {
    std::vector<vpImagePoint> points;
    for (size_t i = 0; i + 1 < numbers.size(); i += 2) {
        points.emplace_back(numbers[i + 1], numbers[i]);
    }
    return points;
}

/// The filtered motion of the target in the image, in normalized coordinates a second.
class TargetMotion {
    using Filter = vpLinearKalmanFilterInstantiation;

public:
    TargetMotion(const Options &options, unsigned int signals) : signals(signals) {
        filter.setStateModel(Filter::stateConstVelWithColoredNoise_MeasureVel);
        vpColVector state(filter.getStateSize() * signals, options.filter[0]);
        vpColVector measure(signals, options.filter[1]);
        // The period has no effect on this model.
        filter.initFilter(signals, state, measure, options.filter[2], 0.0);
    }

    /// The motion, with the error of one more frame and the velocity of the robot.
    vpColVector learn(const vpServo &task, double exposed_s, const vpColVector &velocity) {
        const vpColVector error = task.getError();
        vpColVector measured(signals, 0.0), filtered(signals, 0.0);
        if (frames >= 2) {
            measured = (error - last_error) / (exposed_s - last_s);
            measured -= task.getTaskJacobian() * velocity;
        }
        filter.filter(measured);
        for (unsigned int i = 0; i < signals && frames >= 2; i++) {
            filtered[i] = filter.Xest[i * filter.getStateSize()];
        }
        last_error = error;
        last_s = exposed_s;
        frames++;
        return filtered;
    }

private:
    unsigned int signals;
    Filter filter;
    unsigned int frames = 0;
    vpColVector last_error;
    double last_s = 0.0;
};

/// One run.
class Run {
public:
    Run(const Options &options, const std::string &scene) : compensates(options.compensates) {
        camera.initPersProjWithoutDistortion(number(scene, "fx"), number(scene, "fy"),
                                             number(scene, "cx"), number(scene, "cy"));
        limits = vpColVector(numbers(scene, "limits"));
        const std::vector<double> pattern = numbers(scene, "pattern");
        const std::vector<vpImagePoint> wanted = pixels(numbers(scene, "features"));
        points.resize(wanted.size());
        present.resize(wanted.size());
        goal.resize(wanted.size());
        for (size_t i = 0; i < wanted.size(); i++) {
            const double *point = &pattern.at(3 * i);
            points[i].setWorldCoordinates(point[0], point[1], point[2]);
            vpFeatureBuilder::create(goal[i], camera, wanted[i]);
            // The present interaction matrix needs no depth at the goal.
            goal[i].set_Z(1.0);
            task.addFeature(present[i], goal[i]);
        }
        task.setServo(vpServo::EYEINHAND_CAMERA);
        task.setInteractionMatrixType(vpServo::CURRENT, vpServo::PSEUDO_INVERSE);
        task.setLambda(options.gain[0], options.gain[1], options.gain[2]);
        const auto signals = 2 * static_cast<unsigned int>(points.size());
        motion.reset(new TargetMotion(options, signals));
    }

    ~Run() { task.kill(); }

    /// The answer to what arrived in a period: zero where a point is hidden, and the last twist
    /// without a frame.
    const vpColVector &answer(const std::string &line) {
        const std::vector<vpImagePoint> seen = pixels(numbers(line, "points"));
        if (seen.size() == points.size()) {
            const vpColVector wanted = servo(seen, number(line, "exposed"));
            twist = vpRobot::saturateVelocities(wanted, limits);
        } else if (line.find("\"points\":null") == std::string::npos) {
            twist = 0.0;
        }
        return twist;
    }

private:
    vpColVector servo(const std::vector<vpImagePoint> &seen, double exposed_s) {
        vpPose view;
        for (size_t i = 0; i < points.size(); i++) {
            vpFeatureBuilder::create(present[i], camera, seen[i]);
            points[i].set_x(present[i].get_x());
            points[i].set_y(present[i].get_y());
            view.addPoint(points[i]);
        }
        estimate(view);
        for (size_t i = 0; i < points.size(); i++) {
            vpColVector placed;
            points[i].changeFrame(pose, placed);
            present[i].set_Z(placed[2]);
        }
        vpColVector wanted = task.computeControlLaw();
        if (compensates) {
            // The robot moves as told, so that the last twist is its measured velocity.
            const vpColVector target = motion->learn(task, exposed_s, twist);
            wanted -= task.getTaskJacobianPseudoInverse() * target;
        }
        return wanted;
    }

    /// The pattern's pose by virtual visual servoing from the last one; at first from the better of
    /// two linear ones.
    void estimate(vpPose &view) {
        if (has_pose) {
            view.computePose(vpPose::VIRTUAL_VS, pose);
            return;
        }
        double least = std::numeric_limits<double>::infinity();
        for (const auto method : {vpPose::LAGRANGE_VIRTUAL_VS, vpPose::DEMENTHON_VIRTUAL_VS}) {
            vpHomogeneousMatrix candidate;
            view.computePose(method, candidate);
            const double residual = view.computeResidual(candidate);
            if (residual < least) {
                least = residual;
                pose = candidate;
            }
        }
        has_pose = true;
    }

    bool compensates;
    vpCameraParameters camera;
    vpColVector limits;
    std::vector<vpPoint> points;
    std::vector<vpFeaturePoint> present, goal;
    vpServo task;
    std::unique_ptr<TargetMotion> motion;
    vpHomogeneousMatrix pose;
    bool has_pose = false;
    vpColVector twist = vpColVector(6, 0.0);
};

/// Three numbers with commas between them.
std::array<double, 3> three(const std::string &text) {
    std::istringstream words(text);
    std::array<double, 3> numbers;
    for (double &value : numbers) {
        if (!(words >> value)) {
            throw std::runtime_error("`" + text + "`; expected: three numbers");
        }
        words.ignore(1, ',');
    }
    return numbers;
}

Options parse(const std::vector<std::string> &words) {
    Options options;
    for (size_t i = 0; i < words.size(); i++) {
        const bool has_value = i + 1 < words.size();
        if (words[i] == "--compensate") {
            options.compensates = true;
        } else if (words[i] == "--gain" && has_value) {
            options.gain = three(words[++i]);
        } else if (words[i] == "--filter" && has_value) {
            options.filter = three(words[++i]);
        } else {
            throw std::runtime_error(words[i] + "; expected: --compensate, --gain, --filter");
        }
    }
    return options;
}

} // namespace

int main(int argc, char **argv) {
    try {
        const Options options = parse({argv + 1, argv + argc});
        std::unique_ptr<Run> run;
        std::string scene;
        std::cout.precision(17);
        for (std::string line; std::getline(std::cin, line);) {
            if (line.compare(0, 8, "{\"scene\"") == 0) {
                scene = line;
                std::cout << "\"ready\"" << std::endl;
            } else if (line.compare(0, 6, "{\"run\"") == 0) {
                run.reset(new Run(options, scene));
                std::cout << "\"ready\"" << std::endl;
            } else if (!run) {
                throw std::runtime_error("`" + line + "`; expected: a run");
            } else {
                const vpColVector &twist = run->answer(line);
                for (unsigned int i = 0; i < 6; i++) {
                    std::cout << (i > 0 ? "," : "[") << twist[i];
                }
                std::cout << "]" << std::endl;
            }
        }
    } catch (const std::exception &error) {
        std::cerr << "visp: " << error.what() << std::endl;
        return 1;
    }
    return 0;
}
