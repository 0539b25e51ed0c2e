//! The loop's real surroundings: CLOCK_MONOTONIC, the ports of iceoryx2, the stop file, and the
//! queues to the ordinary thread.

use decision::{ControlStep, Input, Inputs};
use ipc::{ControllerPorts, PublishError, ReceiveError, StopFile};
use messages::{
    CycleRecord, DesiredTwist, Features, Order, Received, Reply, Request, RobotState, TwistCommand,
};

use crate::clock;
use crate::flight::{DumpRequest, Producer};
use crate::usage::Usage;
use crate::world::World;

/// Them.
pub struct Machine {
    ports: ControllerPorts,
    stop_file: StopFile,
    producer: Producer,
    dump: DumpRequest,
}

impl Machine {
    /// The surroundings of a loop that begins with `control`.
    pub fn new(
        ports: ControllerPorts,
        stop_file: StopFile,
        mut producer: Producer,
        dump: DumpRequest,
        control: &ControlStep,
    ) -> Self {
        producer.begin(control, ipc::now_ns());
        Self {
            ports,
            stop_file,
            producer,
            dump,
        }
    }
}

impl World for Machine {
    type Unsent = PublishError;

    fn now_ns(&mut self) -> u64 {
        ipc::now_ns()
    }

    fn suspended_ns(&mut self) -> u64 {
        ipc::suspended_ns()
    }

    fn usage(&mut self) -> Usage {
        Usage::now()
    }

    fn sleep_until(&mut self, deadline_ns: u64) {
        clock::sleep_until(deadline_ns);
    }

    fn yield_now(&mut self) {
        std::thread::yield_now();
    }

    fn features(&mut self) -> Input<Features> {
        match self.ports.features.latest() {
            // By the history of the service.
            Ok(Some(received)) if received.order == Order::Repeated => Input::Nothing,
            received => input(received),
        }
    }

    fn robot(&mut self) -> Input<RobotState> {
        input(self.ports.robot.latest())
    }

    fn desired(&mut self) -> Input<DesiredTwist> {
        input(self.ports.desired.latest())
    }

    fn request(&mut self) -> Input<Request> {
        input(self.ports.requests.oldest())
    }

    fn is_stop_asked(&mut self) -> bool {
        self.stop_file.is_asked()
    }

    fn obey_stop(&mut self) {
        self.stop_file.obey();
    }

    fn send(&mut self, command: &TwistCommand) -> Result<(), PublishError> {
        self.ports.twist.publish(command).map(|_| ())
    }

    fn reply(&mut self, reply: &Reply) {
        let mut reply = *reply;
        (reply.stamp.sequence, reply.stamp.published_ns) = match self.ports.replies.publish(&reply)
        {
            Ok(sent) => (sent.sequence, sent.published_ns),
            Err(_) => (0, ipc::now_ns()),
        };
        self.producer.reply(&reply);
    }

    fn dump(&mut self) {
        self.dump.make();
    }

    fn keep(&mut self, record: &mut CycleRecord, inputs: &Inputs, control: &ControlStep) {
        record.lost_records = self.producer.lost();
        self.producer.cycle(record, inputs, control);
    }

    fn is_unheard(&self) -> bool {
        self.producer.is_abandoned()
    }
}

/// What came from a port.
fn input<T>(received: Result<Option<Received<T>>, ReceiveError>) -> Input<T> {
    match received {
        Ok(Some(received)) => Input::Message(received.message),
        Ok(None) => Input::Nothing,
        Err(ReceiveError::Invalid { stamp, .. }) => Input::Refused(stamp),
        Err(ReceiveError::Transport { .. }) => Input::Failed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_that_breaks_the_contract_is_refused_with_its_head() {
        let mut message = Features::new(&[[1.0; 2]; 4], 5);
        (message.stamp.sequence, message.count) = (7, 99);
        let (invalid, stamp) = (
            messages::Message::check(&message).unwrap_err(),
            message.stamp,
        );
        let found = input::<Features>(Err(ReceiveError::Invalid { invalid, stamp }));
        assert_eq!(found, Input::Refused(stamp));
        assert_eq!(input::<Features>(Ok(None)), Input::Nothing);
    }
}
