use std::mem::{offset_of, size_of};
use std::path::Path;

use super::*;

/// Rows of (expression in C, its value here).
fn expected() -> Vec<(&'static str, u64)> {
    let mut rows: Vec<(&str, u64)> = vec![
        ("V4L2_BUF_TYPE_VIDEO_CAPTURE", BUF_TYPE_VIDEO_CAPTURE.into()),
        ("V4L2_MEMORY_MMAP", MEMORY_MMAP.into()),
        ("V4L2_FIELD_NONE", FIELD_NONE.into()),
        ("V4L2_CAP_VIDEO_CAPTURE", CAP_VIDEO_CAPTURE.into()),
        ("V4L2_CAP_STREAMING", CAP_STREAMING.into()),
        ("V4L2_CAP_DEVICE_CAPS", CAP_DEVICE_CAPS.into()),
        ("V4L2_CAP_TIMEPERFRAME", CAP_TIMEPERFRAME.into()),
        ("V4L2_CID_EXPOSURE_AUTO", CID_EXPOSURE_AUTO.into()),
        ("V4L2_CID_EXPOSURE_ABSOLUTE", CID_EXPOSURE_ABSOLUTE.into()),
        ("V4L2_EXPOSURE_MANUAL", EXPOSURE_IS_FIXED[0] as u64),
        (
            "V4L2_EXPOSURE_SHUTTER_PRIORITY",
            EXPOSURE_IS_FIXED[1] as u64,
        ),
        ("V4L2_BUF_FLAG_ERROR", ERROR.into()),
        ("V4L2_BUF_FLAG_TIMESTAMP_MASK", TIMESTAMP_MASK.into()),
        (
            "V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC",
            TIMESTAMP_MONOTONIC.into(),
        ),
        ("V4L2_BUF_FLAG_TSTAMP_SRC_MASK", TSTAMP_SRC_MASK.into()),
        ("V4L2_BUF_FLAG_TSTAMP_SRC_SOE", TSTAMP_SRC_SOE.into()),
        ("V4L2_PIX_FMT_GREY", fourcc(b"GREY").into()),
        ("V4L2_PIX_FMT_YUYV", fourcc(b"YUYV").into()),
        ("VIDIOC_QUERYCAP", QUERYCAP.into()),
        ("VIDIOC_ENUM_FMT", ENUM_FMT.into()),
        ("VIDIOC_S_FMT", S_FMT.into()),
        ("VIDIOC_REQBUFS", REQBUFS.into()),
        ("VIDIOC_QUERYBUF", QUERYBUF.into()),
        ("VIDIOC_QBUF", QBUF.into()),
        ("VIDIOC_DQBUF", DQBUF.into()),
        ("VIDIOC_STREAMON", STREAMON.into()),
        ("VIDIOC_S_PARM", S_PARM.into()),
        ("VIDIOC_G_CTRL", G_CTRL.into()),
    ];
    // Sizes are part of the opcodes, too, but for that of `int`.
    macro_rules! layout {
        ($ours:ty, $theirs:literal: $($field:ident = $name:literal),*) => {
            rows.push((concat!("sizeof(struct ", $theirs, ")"), size_of::<$ours>() as u64));
            rows.push((concat!("_Alignof(struct ", $theirs, ")"), align_of::<$ours>() as u64));
            $(rows.push((
                concat!("offsetof(struct ", $theirs, ", ", $name, ")"),
                offset_of!($ours, $field) as u64,
            ));)*
        };
    }
    layout!(Capability, "v4l2_capability": driver = "driver", card = "card",
        capabilities = "capabilities", device_caps = "device_caps");
    layout!(FmtDesc, "v4l2_fmtdesc": index = "index", kind = "type", pixelformat = "pixelformat");
    layout!(Format, "v4l2_format": kind = "type", width = "fmt.pix.width",
        height = "fmt.pix.height", pixelformat = "fmt.pix.pixelformat", field = "fmt.pix.field",
        bytesperline = "fmt.pix.bytesperline", sizeimage = "fmt.pix.sizeimage");
    layout!(StreamParm, "v4l2_streamparm": kind = "type", capability = "parm.capture.capability",
        numerator = "parm.capture.timeperframe.numerator",
        denominator = "parm.capture.timeperframe.denominator");
    layout!(RequestBuffers, "v4l2_requestbuffers": count = "count", kind = "type",
        memory = "memory");
    layout!(V4l2Buffer, "v4l2_buffer": index = "index", kind = "type", bytesused = "bytesused",
        flags = "flags", seconds = "timestamp.tv_sec", microseconds = "timestamp.tv_usec",
        sequence = "sequence", memory = "memory", offset = "m.offset", length = "length",
        request_fd = "request_fd");
    layout!(Control, "v4l2_control": id = "id", value = "value");
    rows
}

#[test]
fn structs_and_numbers_are_those_of_the_kernels_header() {
    if !Path::new("/usr/include/linux/videodev2.h").exists() {
        testkit::not_run("V4L2 beside the kernel's header", "no linux/videodev2.h");
        return;
    }
    let rows = expected();
    let prints: String = (rows.iter())
        .map(|(expression, _)| {
            format!("printf(\"%llu\\n\", (unsigned long long)({expression}));\n")
        })
        .collect();
    let program = format!(
        "#include <stddef.h>\n#include <stdio.h>\n#include <linux/videodev2.h>\nint main(void) {{\n{prints}return 0;\n}}\n"
    );
    let directory = tempfile::tempdir().unwrap();
    let [source, probe] = ["probe.c", "probe"].map(|name| directory.path().join(name));
    std::fs::write(&source, program).unwrap();
    let built = testkit::command("cc")
        .arg(&source)
        .arg("-o")
        .arg(&probe)
        .status();
    assert!(built.unwrap().success());
    let said = testkit::command(&probe).output().unwrap().stdout;
    let said: Vec<u64> = String::from_utf8(said)
        .unwrap()
        .lines()
        .map(|line| line.parse().unwrap())
        .collect();
    assert_eq!(said.len(), rows.len());
    for ((expression, ours), theirs) in rows.into_iter().zip(said) {
        assert_eq!(ours, theirs, "{expression}");
    }
}

#[test]
fn codes_of_formats_are_their_names() {
    assert_eq!(fourcc_name(fourcc(b"MJPG")), "MJPG");
    assert_eq!(fourcc_name(0x2020_3859), "Y8");
}
