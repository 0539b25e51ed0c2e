//! RTPS datagrams that this gateway itself has sent: which carry a twist, and the same with a zero
//! twist. Pure. Nothing here reads what came from the network.
//!
//! Source: OMG RTPS 2.5, 8.3 and 9.4. A datagram is a header of 20 bytes and submessages; each has
//! an identifier, flags, and the length of what follows.

/// A writer or reader: 12 bytes of its participant, 4 of its own.
pub type Guid = [u8; 16];

const HEADER: usize = 20;
const INFO_TS: u8 = 0x09;
const DATA: u8 = 0x15;
const HEARTBEAT: u8 = 0x07;
/// Flags: little endian; a HEARTBEAT that asks for no answer; an INFO_TS without a time.
const LITTLE: u8 = 1;
const FINAL: u8 = 2;
const NO_TIME: u8 = 2;
/// In a DATA submessage, behind its four bytes: the writer, and the number of the sample.
const WRITER: usize = 8;
const NUMBER: usize = 12;
/// Where the encapsulated payload begins when there is no inline QoS.
const PAYLOAD: usize = 20;
/// Six numbers at the end of a TwistStamped.
const TWIST: usize = 48;
/// Encapsulation and stamp before them at least, and the stamp's place.
const LEAST: usize = 12;
const STAMP: usize = 4;
/// Far beyond the counts of the gateway's own heartbeats, which receivers compare.
const COUNT: u32 = 0x4000_0000;

/// A datagram with a twist.
#[derive(Clone, Debug, PartialEq)]
pub struct Sent {
    bytes: Vec<u8>,
    /// Where its DATA and its last INFO_TS begin, behind their four bytes.
    data: usize,
    time: Option<usize>,
    /// The sample's number: those of a writer rise by one.
    pub number: u64,
}

impl Sent {
    /// Reads a datagram; `None` where this writer sent no sample in it.
    pub fn read(datagram: &[u8], writer: &Guid) -> Option<Self> {
        if !datagram.starts_with(b"RTPS") || datagram.get(8..HEADER)? != &writer[..12] {
            return None;
        }
        let (mut at, mut time, mut found) = (HEADER, None, None);
        while let Some([kind, flags, low, high]) = datagram.get(at..at + 4) {
            let begin = at + 4;
            let length = usize::from(u16::from_le_bytes([*low, *high]));
            let end = match length {
                0 if *kind == DATA => datagram.len(),
                _ => begin + length,
            };
            let body = datagram.get(begin..end)?;
            if flags & LITTLE == 0 {
                return None;
            }
            match *kind {
                INFO_TS => time = (flags & NO_TIME == 0).then_some(begin),
                DATA if body.get(WRITER..WRITER + 4) == Some(&writer[12..]) => {
                    // Of a sample that has its payload, and nothing between.
                    let is_whole = body.len() >= PAYLOAD + LEAST + TWIST && flags & 0b1110 == 0b100;
                    is_whole.then_some(())?;
                    found = Some((begin, end, time));
                }
                _ => (),
            }
            at = end;
        }
        let (data, end, time) = found?;
        let mut sent = Self {
            bytes: datagram[..end].to_vec(),
            data,
            time,
            number: 0,
        };
        let half = |at: usize| u64::from(u32::from_le_bytes(sent.four(data + at)));
        sent.number = half(NUMBER) << 32 | half(NUMBER + 4);
        Some(sent)
    }

    fn four(&self, at: usize) -> [u8; 4] {
        std::array::from_fn(|k| self.bytes[at + k])
    }

    fn put(&mut self, at: usize, bytes: &[u8]) {
        self.bytes[at..at + bytes.len()].copy_from_slice(bytes);
    }

    /// Whether its twist is zero.
    pub fn is_zero(&self) -> bool {
        let twist = &self.bytes[self.bytes.len() - TWIST..];
        twist.chunks(8).all(|number| {
            let number = std::array::from_fn(|k| number[k]);
            f64::from_le_bytes(number) == 0.0
        })
    }

    /// The same with a zero twist, as the sample `number` at `seconds` and `nanoseconds` of the
    /// wall clock. A heartbeat follows that says that this is the writer's only sample, so that
    /// reliable receivers wait for none that they miss.
    pub fn zero(&self, number: u64, seconds: u32, nanoseconds: u32) -> Vec<u8> {
        let mut zero = self.clone();
        let halves = [(number >> 32) as u32, number as u32].map(u32::to_le_bytes);
        let halves = halves.as_flattened();
        if let Some(time) = self.time {
            let fraction = (u64::from(nanoseconds) << 32) / 1_000_000_000;
            zero.put(time, &seconds.to_le_bytes());
            zero.put(time + 4, &(fraction as u32).to_le_bytes());
        }
        let length = (zero.bytes.len() - self.data) as u16;
        zero.put(self.data - 2, &length.to_le_bytes());
        zero.put(self.data + NUMBER, halves);
        let stamp = self.data + PAYLOAD + STAMP;
        zero.put(stamp, &seconds.to_le_bytes());
        zero.put(stamp + 4, &nanoseconds.to_le_bytes());
        let twist = zero.bytes.len() - TWIST;
        zero.put(twist, &[0; TWIST]);
        let mut bytes = zero.bytes;
        bytes.extend([HEARTBEAT, LITTLE | FINAL, 28, 0]);
        // To all readers.
        bytes.extend([0; 4]);
        bytes.extend(self.four(self.data + WRITER));
        bytes.extend([halves, halves].concat());
        bytes.extend(COUNT.wrapping_add(number as u32).to_le_bytes());
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WRITER_GUID: Guid = [1, 18, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 0, 0, 5, 3];

    /// As RustDDS sends it: where to, when, the sample, a heartbeat.
    fn datagram(number: u8, twist: f64) -> Vec<u8> {
        let mut bytes = b"RTPS\x02\x04\x01\x12".to_vec();
        bytes.extend(&WRITER_GUID[..12]);
        bytes.extend([0x0e, 1, 12, 0]);
        bytes.extend([9; 12]);
        bytes.extend([INFO_TS, 1, 8, 0, 1, 2, 3, 4, 5, 6, 7, 8]);
        let payload = {
            let mut payload = vec![0, 1, 0, 0, 7, 7, 7, 7, 8, 8, 8, 8, 4, 0, 0, 0];
            payload.extend(b"cam\0");
            payload.extend([twist; 6].map(f64::to_le_bytes).as_flattened());
            payload
        };
        let length = (PAYLOAD + payload.len()) as u16;
        bytes.extend([DATA, 5]);
        bytes.extend(length.to_le_bytes());
        bytes.extend([0, 0, 16, 0, 0, 0, 0, 4, 0, 0, 5, 3]);
        bytes.extend([0, 0, 0, 0, number, 0, 0, 0]);
        bytes.extend(payload);
        bytes.extend([HEARTBEAT, 1, 28, 0]);
        bytes.extend([0; 28]);
        bytes
    }

    #[test]
    fn a_sent_twist_is_sent_again_as_zero_with_a_new_number() {
        let sent = Sent::read(&datagram(7, 0.1), &WRITER_GUID).unwrap();
        assert_eq!((sent.number, sent.is_zero()), (7, false));
        let zero = sent.zero(1 << 32 | 9, 100, 500_000_000);
        let read = Sent::read(&zero, &WRITER_GUID).unwrap();
        assert_eq!((read.number, read.is_zero()), (1 << 32 | 9, true));
        let stamp = read.data + PAYLOAD + STAMP;
        assert_eq!(u32::from_le_bytes(read.four(stamp)), 100);
        assert_eq!(u32::from_le_bytes(read.four(stamp + 4)), 500_000_000);
        // Half a second, in parts of 2^32.
        assert_eq!(read.four(read.time.unwrap() + 4), [0, 0, 0, 0x80]);
        // Its own heartbeat in the place of the old one: first and last are the sample.
        let heartbeat = &zero[zero.len() - 32..];
        assert_eq!(heartbeat[..4], [HEARTBEAT, 3, 28, 0]);
        assert_eq!(heartbeat[12..20], [1, 0, 0, 0, 9, 0, 0, 0]);
        assert_eq!(heartbeat[12..20], heartbeat[20..28]);
        assert_eq!(zero.len(), datagram(7, 0.1).len());
    }

    #[test]
    fn what_is_no_twist_of_this_writer_is_passed_over() {
        let twist = datagram(7, 0.0);
        assert!(Sent::read(&twist, &WRITER_GUID).unwrap().is_zero());
        let mut other = WRITER_GUID;
        other[14] ^= 1;
        assert_eq!(Sent::read(&twist, &other), None);
        other = WRITER_GUID;
        other[0] ^= 1;
        assert_eq!(Sent::read(&twist, &other), None);
        for length in 0..twist.len() - 32 {
            assert_eq!(Sent::read(&twist[..length], &WRITER_GUID), None);
        }
    }
}
