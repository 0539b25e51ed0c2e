//! What is promised, one line each; a property of the simulation has the name of its promise.

/// Declares the promises with their names and lines.
macro_rules! promises {
    ($($promise:ident $name:literal $line:literal)+) => {
        /// A promise.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[allow(missing_docs)]
        pub enum Promise {
            $($promise,)+
        }

        /// All of them, with name and line.
        pub const PROMISES: &[(Promise, &str, &str)] = &[$((Promise::$promise, $name, $line),)+];
    };
}

promises! {
    Unasked "unasked" "nothing moves that nobody has asked for"
    Consent "consent" "who arms after a stop or a disarm names it"
    Stop "stop" "a stop is zero in its cycle, and within three periods"
    DeadMan "dead man" "the robot stands when its last command is no longer in force"
    Rest "rest" "it stands 0.1 s after the last command"
    Limits "limits" "no command is beyond the scene's limits"
    Cell "cell" "no command is beyond the limits that an operator has armed"
    Steps "steps" "no command changes by more than the scene's acceleration"
    Slow "slow" "no brake is steeper than from the limits to zero in brake_s"
    Held "held" "a command that is held does not grow"
    Still "still" "disarmed and holding are zero, with a cause"
    Silence "silence" "the law moves nothing three periods after the last message"
    Blind "blind" "the law moves nothing blind_s after the last whole image"
    Joints "joints" "no joint of the arm leaves its range"
    Brake "brake" "a fault is braked in its time"
    Zero "zero" "zero follows in the time of a brake"
    Disarm "disarm" "a fault disarms"
    Cause "cause" "the cause is named"
    GoesOn "goes on" "what is harmless is forgiven"
    Motion "motion" "what is armed moves"
    Arrives "arrives" "without a fault it arrives"
    Late "late requests" "a request that waited for 0.3 s moves nothing"
    Replies "replies" "each request is answered in its cycle"
    Restart "restart" "a restart begins disarmed"
    NoRobot "no robot" "nothing is armed before a robot is heard"
    Guardian "guardian" "a guarded camera loses no point and stands when its program is silent"
    End "end" "it ends in time, and its last word is zero"
    Replay "replay" "a replay repeats every bit"
    Panic "panic" "the loop never panics"
    World "world" "the run comes to an end"
}

/// How many promises there are.
pub const COUNT: usize = PROMISES.len();

impl Promise {
    /// Its name.
    pub fn name(self) -> &'static str {
        PROMISES[self as usize].1
    }
}
